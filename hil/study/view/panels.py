"""What the viewers show: the one table of plots, resolved against the columns that a log has."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.tick_columns import Column
from hil.record.row import NUMBER
from hil.record.selection import Component, components
from hil.study.log_columns import DIFFERENCE

TABS: dict[str, dict[str, tuple[str, ...]]] = {
    "Errors": {"Leg error": ("q_d - q",), "Position error": ("p_d - p",), "Innovation": ("innovation_q",)},
    "Forces": {"Leg force": ("tau", "drive_force"), "Load on the platform": ("wrench",)},
    "Motion": {"Leg length": ("q_d", "q"), "Leg rate": ("dq_d", "dq"), "Position": ("p_d", "p")},
    "Certificate": {
        "Lyapunov function": ("lyapunov", "lyapunov_bound"),
        "Share": ("lyapunov_share", "encoder_share"),
    },
    "Timing": {
        "Lateness and computing time": ("lateness_ns", "compute_ns"),
        "Skipped periods, frames received": ("skipped", "frames_received"),
        "Age of the feedback": ("age",),
    },
}
"""Tab -> plot -> columns, or `one - other`."""
NAMED_FIRST = ("mode", "command_mode", "faults", "warnings", "drive_state")
"""States that stand on top; the others follow in the order of the columns."""


class Curve(NamedTuple):
    """One line of a plot."""

    label: str
    """`tau.leg_3`, or `q_d.leg_3 - q.leg_3`."""
    unit: str
    part: Component
    less: Component | None = None
    """What is subtracted."""

    def of(self, rows: Rows) -> np.ndarray[tuple[int], np.dtype[Any]]:
        """Return its values (n,) in rows."""
        return self.part.of(rows) - self.less.of(rows) if self.less else self.part.of(rows)

    @property
    def title(self) -> str:
        """Label with its unit."""
        return titled(self.label, self.unit)


class Plot(NamedTuple):
    """Curves over time."""

    tab: str
    title: str
    curves: tuple[Curve, ...]


def titled(label: str, unit: str) -> str:
    """Return a label with its unit, `tau.leg_3 [N]`."""
    return f"{label} [{unit}]" if unit else label


def plots(columns: Sequence[Column]) -> list[Plot]:
    """Return the plots of TABS whose columns are all there, at least one curve each."""
    there = {c.name for c in columns}
    found = []
    for tab, titles in TABS.items():
        for title, names in titles.items():
            kept = [name for name in names if there.issuperset(name.split(DIFFERENCE))]
            curves = tuple(curve for name in kept for curve in _curves(columns, name))
            if curves:
                found.append(Plot(tab, title, curves))
    return found


def _curves(columns: Sequence[Column], name: str) -> list[Curve]:
    sides = [components(columns, [side], "") for side in name.split(DIFFERENCE)]
    if len(sides) == 1:
        return [Curve(part.label, part.unit, part) for part in sides[0]]
    return [Curve(f"{a.label}{DIFFERENCE}{b.label}", a.unit, a, b) for a, b in zip(*sides, strict=True)]


def differences(columns: Sequence[Column]) -> list[Curve]:
    """Return the curves that stand in no log: one column less another."""
    return [curve for plot in plots(columns) for curve in plot.curves if curve.less]


def states(columns: Sequence[Column]) -> list[Column]:
    """Return the columns whose numbers have names, the most important ones first."""
    named = {c.name: c for c in columns if c.names}
    first = [named.pop(name) for name in NAMED_FIRST if name in named]
    return [*first, *named.values()]


def field(part: Component) -> tuple[str, ...]:
    """Return where the log's message has the number of a component: names of fields, the inmost last.

    An element without a name stands in a repeated field, `name[3]`.
    """
    column = part.column
    name = column.name + NUMBER if column.names else column.name
    if not column.shape:
        return (name,)
    return (name, column.elements[part.element]) if column.elements else (f"{name}[{part.element}]",)
