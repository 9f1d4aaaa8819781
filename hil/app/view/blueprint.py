"""What a Rerun viewer opens: the robot in 3D, lanes of states, plots in tabs, events."""

from collections.abc import Sequence
from typing import Any

from drivers.tick_columns import Column
from hil.app.view.panels import Plot, plots, states
from hil.app.view.paths import EVENTS, SCENE, curve_path

TIME = "log_time"
"""Time line that is shown: UTC."""


def blueprint(columns: Sequence[Column], topic: str, *, scene: bool) -> Any:
    """Return the blueprint for a log with these columns; `scene` asks for the 3D view. Needs rerun-sdk."""
    from rerun import blueprint as rrb  # noqa: PLC0415 - an extra

    lanes = [f"+ {topic}/{c.name}/**" for c in states(columns)]
    left = [rrb.Spatial3DView(origin=SCENE, name="Robot")] if scene else []
    if lanes:
        left.append(rrb.StateTimelineView(origin="/", contents=lanes, name="States"))
    left.append(rrb.TextLogView(origin=EVENTS, name="Events"))
    tabs: dict[str, list[Plot]] = {}
    for plot in plots(columns):
        tabs.setdefault(plot.tab, []).append(plot)
    pages = [
        rrb.Vertical(*(_plot(rrb, plot, topic) for plot in members), name=tab)
        for tab, members in tabs.items()
    ]
    pages.append(rrb.DataframeView(origin=topic, name="All columns"))
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(*left), rrb.Tabs(*pages)),
        rrb.TimePanel(timeline=TIME),
        collapse_panels=True,
    )


def _plot(rrb: Any, plot: Plot, topic: str) -> Any:
    contents = [f"+ {curve_path(topic, curve)}" for curve in plot.curves]
    return rrb.TimeSeriesView(origin="/", contents=contents, name=plot.title)
