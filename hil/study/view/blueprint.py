"""What a Rerun viewer opens: the robot in 3D, lanes of states, plots in tabs, events; and where each is."""

from collections.abc import Sequence
from typing import Any

from drivers.tick_columns import Column
from hil.study.log_columns import Curve
from hil.study.view.panels import Plot, plots, states

SCENE = "/robot"
"""The robot; its frame is the base frame."""
EVENTS = "/events"
DIFFERENCES = "/differences"
"""What is one column less another."""
TIME = "log_time"
"""Time line that is shown: UTC."""

FIRST = ("mode", "command_mode", "faults", "warnings")
"""States beside the robot; all of them have a tab."""


def blueprint(columns: Sequence[Column], topic: str, *, scene: bool) -> Any:
    """Return the blueprint for a log with these columns; `scene` asks for the 3D view. Needs rerun-sdk."""
    from rerun import blueprint as rrb  # noqa: PLC0415 - an extra

    named = [c.name for c in states(columns)]
    views: list[tuple[Any, int]] = [(rrb.Spatial3DView(origin=SCENE, name="Robot"), 4)] if scene else []
    first = [name for name in named if name in FIRST]
    if first:
        views.append((_states(rrb, topic, first, "State"), 2))
    views.append((rrb.TextLogView(origin=EVENTS, name="Events"), 1))
    tabs: dict[str, list[Plot]] = {}
    for plot in plots(columns):
        tabs.setdefault(plot.tab, []).append(plot)
    pages: list[Any] = [
        rrb.Vertical(*(_plot(rrb, plot, topic) for plot in members), name=tab)
        for tab, members in tabs.items()
    ]
    if named:
        pages.append(_states(rrb, topic, named, "States"))
    pages.append(rrb.DataframeView(origin=topic, name="All columns"))
    left, shares = zip(*views, strict=True)
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*left, row_shares=shares), rrb.Tabs(*pages)),
        rrb.TimePanel(timeline=TIME, state="collapsed"),
        collapse_panels=True,
    )


def _states(rrb: Any, topic: str, names: Sequence[str], title: str) -> Any:
    return rrb.StateTimelineView(origin="/", contents=[f"+ {topic}/{name}/**" for name in names], name=title)


def _plot(rrb: Any, plot: Plot, topic: str) -> Any:
    contents = [f"+ {curve_path(topic, curve)}" for curve in plot.curves]
    return rrb.TimeSeriesView(origin="/", contents=contents, name=plot.title)


def path_of(topic: str, label: str) -> str:
    """Entity of a component: `/tick/tau/leg_3`."""
    return f"{topic}/{label.replace('.', '/')}"


def curve_path(topic: str, curve: Curve) -> str:
    """Entity of a curve; of a difference `/differences/q_d-q/leg_3`."""
    if curve.less is None:
        return path_of(topic, curve.label)
    element = curve.part.label.removeprefix(curve.part.column.name)
    return path_of(DIFFERENCES, f"{curve.part.column.name}-{curve.less.column.name}{element}")
