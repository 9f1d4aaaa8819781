"""Limits so patient that a stall of the host does not end a run, and what the stalls would have ended."""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Flags, Rows
from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration
from hil.config.limits import LimitSettings
from tools.benchmarks.figures import Figure

PATIENCE_S = 0.2
"""Stalls up to this long end no run. A virtual machine's host takes its processor away for 5 to 30 ms."""


def make_patient(values: dict[str, Any], rate_Hz: float) -> None:
    """Lengthen watchdog and limits on lost time in place, and let time never stand still."""
    ticks = round(PATIENCE_S * rate_Hz)
    values["drives"]["watchdog_ms"] = 1e3 * PATIENCE_S
    values["loop"]["on_stall"] = "fault"
    values["limits"] |= {"stale_fault_ticks": ticks, "missed_stop_ticks": ticks}


class Lost(NamedTuple):
    """Runs of lost ticks while the drives were powered."""

    longest: int
    """Ticks."""
    events: int
    """Runs that reach the limit."""


def stale(rows: Rows, limit: int) -> Lost:
    """Return the greatest age of a leg's data, and how often it rose to the limit."""
    age = np.where(_powered(rows), rows["age"].max(axis=1), 0)
    over = age >= limit
    return Lost(int(age.max(initial=0)), int(np.count_nonzero(over[1:] & ~over[:-1]) + over[:1].sum()))


def missed(rows: Rows, limit: int) -> Lost:
    """Return the most periods missed in a row, and how often as many as the limit were.

    A tick before which nothing was missed ends a run, as in `hil.safety.kernels.judge_loop`.
    """
    skipped = np.where(_powered(rows), rows["skipped"], 0)
    run = np.bincount(np.cumsum(skipped == 0), skipped) if len(rows) else np.zeros(1)
    return Lost(int(run.max()), int(np.count_nonzero(run >= limit)))


def patience_figures(rows: Rows, run: Configuration, shipped: Configuration) -> list[Figure]:
    """Return the limits of the run beside the shipped ones, and how often the latter were reached."""
    own, usual = run.limits, shipped.limits
    return [
        Figure("patient limits", note=f"{_limits(run, own)} in place of {_limits(shipped, usual)}"),
        _figure("longest age of a leg's data", stale(rows, usual.stale_fault_ticks), usual.stale_fault_ticks),
        _figure(
            "longest run of missed periods", missed(rows, usual.missed_stop_ticks), usual.missed_stop_ticks
        ),
    ]


def _limits(c: Configuration, limits: LimitSettings) -> str:
    return (
        f"stale_fault_ticks {limits.stale_fault_ticks}, missed_stop_ticks {limits.missed_stop_ticks}, "
        f"watchdog_ms {c.drives.watchdog_ms:g}"
    )


def _figure(name: str, lost: Lost, limit: int) -> Figure:
    times = "never" if not lost.events else "once" if lost.events == 1 else f"{lost.events} times"
    note = f"{times} {limit} or more, where the shipped limits end a run"
    return Figure(f"  {name}", {"": float(lost.longest)}, "ticks", note=note)


def _powered(rows: Rows) -> Flags:
    powered: Flags = (rows["mode"] >= Mode.LOADING) & (rows["mode"] <= Mode.UNLOADING)
    return powered
