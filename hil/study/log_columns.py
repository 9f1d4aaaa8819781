"""Selects columns of a log by name, differences of two columns, and the plots of viewer and report."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Rows
from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.log import Log
from hil.record.selection import Component, components

DIFFERENCE = " - "
"""Separator of a difference, first column minus second."""


class Curve(NamedTuple):
    """One number over time: an element of a log column, or the difference of two elements."""

    label: str
    """`tau.leg_3`, or `q_d.leg_3 - q.leg_3`."""
    unit: str
    part: Component
    less: Component | None = None
    """Subtracted component."""

    def of(self, rows: Rows) -> np.ndarray[tuple[int], np.dtype[Any]]:
        """Values (n,) of this curve in n rows of the log."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self.part.of(rows) - self.less.of(rows) if self.less else self.part.of(rows)

    @property
    def columns(self) -> str:
        """Columns of the log, e.g. `tau` or `q_d - q`."""
        parts = (self.part,) if self.less is None else (self.part, self.less)
        return DIFFERENCE.join(part.column.name for part in parts)

    @property
    def title(self) -> str:
        """Label with its unit, e.g. `tau.leg_3 [N]`."""
        return titled(self.label, self.unit)


def titled(label: str, unit: str) -> str:
    """Label with its unit, e.g. `tau.leg_3 [N]`."""
    return f"{label} [{unit}]" if unit else label


def curves(columns: Sequence[Column], name: str, log: str = "") -> list[Curve]:
    """Curves of `column`, `column.element` or `one - other`; one curve per element.

    Raises LogError: unknown column or element (the message names the log), or a difference of columns that
    differ in shape or unit, or whose values have names.
    """
    first, minus, second = (side.strip() for side in name.partition(DIFFERENCE))
    ones = components(columns, [first], log)
    if not minus:
        return [Curve(part.label, part.unit, part) for part in ones]
    others = components(columns, [second], log)
    kinds = [[(part.unit, bool(part.column.names)) for part in side] for side in (ones, others)]
    if kinds[0] != kinds[1] or kinds[0][0][1]:
        raise LogError(
            f"{name}: invalid difference, allowed: two numeric columns with the same shape and unit"
        )
    return [Curve(f"{a.label}{DIFFERENCE}{b.label}", a.unit, a, b) for a, b in zip(ones, others, strict=True)]


def named_columns(names: Iterable[str]) -> set[str]:
    """Log columns that occur in curve names such as `q_d - q` or `tau.leg_3`."""
    sides = (side for name in names for side in name.split(DIFFERENCE))
    return {side.strip().partition(".")[0] for side in sides}


def seconds(rows: Rows) -> Array:
    """Time (n,) of each row, s since the first row."""
    return np.asarray((rows["t_ns"] - rows["t_ns"][:1]) * 1e-9, np.float64)


def has_pose(rows: Rows, p: str, R: str) -> NDArray[np.bool_]:
    """Mask (n,) of the rows with a pose in columns `p` and `R`: finite, and the rotation not all zeros."""
    rotation = rows[R].reshape(len(rows), -1)
    there: NDArray[np.bool_] = rotation.any(axis=1) & np.isfinite(rotation).all(axis=1)
    there &= np.isfinite(rows[p]).all(axis=1)
    return there


def row_groups(log: Log, parts: Sequence[Component], size: int) -> Iterator[Rows]:
    """Yield `tick`, `t_ns` and the components' columns of a log, at least `size` rows at a time.

    Raises LogError: damaged log.
    """
    held: list[Rows] = []
    for block in log.blocks("tick", "t_ns", *(part.column.name for part in parts)):
        held.append(block)
        if sum(map(len, held)) >= size:
            yield np.concatenate(held)
            held = []
    if held:
        yield np.concatenate(held)


TIMES = "Lateness and computing time"
TABS: dict[str, dict[str, tuple[str, ...]]] = {
    "Errors": {"Leg error": ("q_d - q",), "Position error": ("p_d - p",), "Innovation": ("innovation_q",)},
    "Forces": {"Leg force": ("tau", "drive_force"), "Load on the platform": ("wrench",)},
    "Motion": {"Leg length": ("q_d", "q"), "Leg rate": ("dq_d", "dq"), "Position": ("p_d", "p")},
    "Certificate": {
        "Lyapunov function": ("lyapunov", "lyapunov_bound"),
        "Share": ("lyapunov_share", "encoder_share", "sensor_share"),
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
"""Tab -> plot -> columns or `one - other`; for Rerun, the report's page and `configs/viewers`."""
NAMED_FIRST = ("mode", "command_mode", "faults", "warnings", "drive_state")
"""Columns that `states` lists first; the others follow in the order of the log."""


class Plot(NamedTuple):
    """Curves of one plot of the viewer or the report, and the tab that shows it."""

    tab: str
    title: str
    curves: tuple[Curve, ...]


def plots(columns: Sequence[Column]) -> list[Plot]:
    """Plots of TABS with at least one curve; curves of columns missing in the log are left out."""
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
    """Curves of the plots that are differences of two log columns."""
    return [curve for plot in plots(columns) for curve in plot.curves if curve.less]


def states(columns: Sequence[Column]) -> list[Column]:
    """Log columns whose values have names (enumerations, flags), the most important ones first."""
    named = {c.name: c for c in columns if c.names}
    first = [named.pop(name) for name in NAMED_FIRST if name in named]
    return [*first, *named.values()]
