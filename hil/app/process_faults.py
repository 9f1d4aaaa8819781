"""Faults of the plant's own process."""

import os
import signal
import subprocess
import time
from collections.abc import Iterable

from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import PROCESS, ProcessKill, ProcessSlow, ProcessStop


class ProcessFaults:
    """Kills, stops and slows this process when its time has come.

    Mutable state: which faults are still to come.
    """

    def __init__(self, faults: Iterable[Fault], t0_ns: int) -> None:
        self._left = [
            (t0_ns + round(fault.at_s * 1e9), fault) for fault in faults if isinstance(fault, PROCESS)
        ]

    def strike(self, now_ns: int) -> None:
        """Let what is due happen."""
        for entry in list(self._left):
            at_ns, fault = entry
            if now_ns < at_ns:
                continue
            match fault:
                case ProcessKill():
                    os.kill(os.getpid(), signal.SIGKILL)
                case ProcessStop(for_s=for_s):
                    self._left.remove(entry)
                    _stop(for_s)
                case ProcessSlow(by_ms=by_ms) if now_ns < at_ns + fault.lasts_ns:
                    time.sleep(1e-3 * by_ms)
                case _:
                    self._left.remove(entry)


def _stop(for_s: float) -> None:
    """Stop this process; another one lets it go on."""
    script = 'kill -STOP "$1"; sleep "$2"; kill -CONT "$1"'
    subprocess.Popen(
        ["/bin/sh", "-c", script, "sh", str(os.getpid()), f"{for_s:.6f}"], start_new_session=True
    )
