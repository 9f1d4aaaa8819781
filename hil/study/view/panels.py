"""What Rerun and the report show: the one table of plots, resolved against the columns that a log has."""

from collections.abc import Sequence
from typing import NamedTuple

from drivers.tick_columns import Column
from hil.study.log_columns import DIFFERENCE, Curve, curves

TIMES = "Lateness and computing time"
TABS: dict[str, dict[str, tuple[str, ...]]] = {
    "Errors": {"Leg error": ("q_d - q",), "Position error": ("p_d - p",), "Innovation": ("innovation_q",)},
    "Forces": {"Leg force": ("tau", "drive_force"), "Load on the platform": ("wrench",)},
    "Motion": {"Leg length": ("q_d", "q"), "Leg rate": ("dq_d", "dq"), "Position": ("p_d", "p")},
    "Certificate": {
        "Lyapunov function": ("lyapunov", "lyapunov_bound"),
        "Share": ("lyapunov_share", "encoder_share"),
    },
    "Timing": {
        TIMES: ("lateness_ns", "compute_ns"),
        "Skipped periods, frames received": ("skipped", "frames_received"),
        "Age of the feedback": ("age",),
        "Frames refused, not taken, in error or lost": (
            "rejected", "sends_failed", "bus_errors", "bus_overflow",
        ),
        "Bench time that stood still": ("stretched_ns",),
    },
}  # fmt: skip
"""Tab -> plot -> columns, or `one - other`: of Rerun, the report's page and `configs/viewers`."""
NAMED_FIRST = ("mode", "command_mode", "faults", "warnings", "drive_state")
"""States that stand on top; the others follow in the order of the columns."""


class Plot(NamedTuple):
    """Curves over time."""

    tab: str
    title: str
    curves: tuple[Curve, ...]


def plots(columns: Sequence[Column]) -> list[Plot]:
    """Return the plots of TABS whose columns are all there, at least one curve each."""
    there = {c.name for c in columns}
    found = []
    for tab, titles in TABS.items():
        for title, names in titles.items():
            kept = [name for name in names if there.issuperset(name.split(DIFFERENCE))]
            shown = tuple(curve for name in kept for curve in curves(columns, name))
            if shown:
                found.append(Plot(tab, title, shown))
    return found


def differences(columns: Sequence[Column]) -> list[Curve]:
    """Return the curves that stand in no log: one column less another."""
    return [curve for plot in plots(columns) for curve in plot.curves if curve.less]


def states(columns: Sequence[Column]) -> list[Column]:
    """Return the columns whose numbers have names, the most important ones first."""
    named = {c.name: c for c in columns if c.names}
    first = [named.pop(name) for name in NAMED_FIRST if name in named]
    return [*first, *named.values()]
