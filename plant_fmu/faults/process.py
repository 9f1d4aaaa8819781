"""Faults of the plant's process: in real time only."""

from typing import Annotated, Literal

from pydantic import Field

from plant_fmu.faults.fault import Fault, LastingFault


class ProcessKill(Fault):
    """The process is killed (SIGKILL): its drives fall silent and its log is cut."""

    kind: Literal["process_kill"] = "process_kill"


class ProcessStop(Fault):
    """The process is stopped (SIGSTOP) and continued after `for_s`."""

    kind: Literal["process_stop"] = "process_stop"
    for_s: Annotated[float, Field(gt=0, le=3600)]
    """How long it is stopped."""


class ProcessSlow(LastingFault):
    """The process takes this much longer for every round of its loop."""

    kind: Literal["process_slow"] = "process_slow"
    by_ms: Annotated[float, Field(gt=0, le=1000)]


PROCESS = (ProcessKill, ProcessStop, ProcessSlow)
"""What a simulated plant does not have."""
