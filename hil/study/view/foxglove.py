"""A layout for Foxglove and Lichtblick, in the form that both import: panels by id, and how they tile.

Source: the exported layouts of Lichtblick 1.2x (`LayoutData` of @lichtblick/suite-base). What is one column
less another is made by a user script in the viewer.
"""

import importlib.resources
import json
from collections.abc import Sequence
from enum import IntFlag
from typing import Any

from drivers.tick_columns import Column
from hil.study.log_columns import Curve
from hil.study.view.panels import differences, field, plots, states

SCRIPT_TOPIC = "/studio_script/differences"
"""Topic that the user script fills."""
_LANES = 24
"""States in one panel, at most."""


def layout(columns: Sequence[Column], topic: str) -> str:
    """Return the layout for logs with these columns as JSON."""
    fixed = importlib.resources.files("hil.study.view").joinpath("foxglove-panels.json").read_text("utf-8")
    panels: dict[str, Any] = json.loads(fixed.replace("TOPIC", topic))
    panels["StateTransitions!mode"] = _transitions("Mode", _mode(columns, topic))
    pages: dict[str, list[str]] = {}
    for plot in plots(columns):
        place = f"Plot!{_identifier(plot.title)}"
        panels[place] = _plot(plot.title, [_series(topic, curve) for curve in plot.curves])
        pages.setdefault(plot.tab, []).append(place)
    for title, lanes in _lanes(columns, topic).items():
        place = f"StateTransitions!{_identifier(title)}"
        panels[place] = _transitions(title, lanes)
        pages[title] = [place]
    pages["All columns"] = ["RawMessages!row"]
    tabs = [{"title": title, "layout": _stacked(members)} for title, members in pages.items()]
    panels["Tab!columns"] = {"activeTabIdx": 0, "tabs": tabs}
    left = _stacked(["3D!robot", "StateTransitions!mode", "RosOut!events"])
    content = {
        "configById": dict(sorted(panels.items())),
        "globalVariables": {},
        "userNodes": _scripts(columns, topic),
        "playbackConfig": {"speed": 1},
        "layout": _split("row", 45, left, "Tab!columns"),
    }
    return json.dumps(content, indent=1) + "\n"


def curve_path(topic: str, curve: Curve) -> str:
    """Return the message path of a curve: `/tick.tau.leg_3`."""
    if curve.less is None:
        return ".".join((topic, *field(curve.part)))
    return ".".join((SCRIPT_TOPIC, *_difference(curve)))


def _difference(curve: Curve) -> tuple[str, str]:
    """Return the fields of the script's message that hold a difference: `q_d_less_q`, `leg_3`."""
    assert curve.less is not None
    column, element = curve.part.column, curve.part.element
    name = f"{column.name}_less_{curve.less.column.name}"
    return name, column.elements[element] if column.elements else f"element_{element}"


def _lanes(columns: Sequence[Column], topic: str) -> dict[str, list[tuple[str, str]]]:
    """Return title -> label and message path of each state."""
    named = states(columns)
    flags = {
        c.name: [(name, f"{topic}.{c.name}.{name}") for name in c.names]
        for c in named
        if issubclass(c.type, IntFlag)
    }
    found = {"States": [lane for c in named if c.name not in flags for lane in _enumerated(c, topic)]}
    found |= {name.title(): flags.pop(name) for name in ("faults", "warnings") if name in flags}
    rest = [(f"{name}.{flag}", path) for name, lanes in flags.items() for flag, path in lanes]
    for start in range(0, len(rest), _LANES):
        found[f"Flags {start // _LANES + 1}"] = rest[start : start + _LANES]
    return {title: lanes for title, lanes in found.items() if lanes}


def _enumerated(c: Column, topic: str) -> list[tuple[str, str]]:
    return [(label, f"{topic}.{label}") for label in c.labels]


def _mode(columns: Sequence[Column], topic: str) -> list[tuple[str, str]]:
    shown = [c for c in columns if c.name in ("mode", "command_mode") and c.names]
    return [lane for c in shown for lane in _enumerated(c, topic)]


def _plot(title: str, series: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": series,
        "showLegend": True,
        "legendDisplay": "left",
        "showPlotValuesInLegend": True,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 220,
    }


def _series(topic: str, curve: Curve) -> dict[str, Any]:
    return {
        "value": curve_path(topic, curve),
        "label": curve.title,
        "enabled": True,
        "timestampMethod": "receiveTime",
    }


def _transitions(title: str, lanes: Sequence[tuple[str, str]]) -> dict[str, Any]:
    paths = [{"value": path, "label": label, "timestampMethod": "receiveTime"} for label, path in lanes]
    return {"foxglovePanelTitle": title, "isSynced": True, "paths": paths}


def _scripts(columns: Sequence[Column], topic: str) -> dict[str, Any]:
    """Return the user script that makes the differences; none where there are none."""
    fields: dict[str, list[str]] = {}
    for curve in differences(columns):
        assert curve.less is not None
        name, element = _difference(curve)
        value = f"row.{'.'.join(field(curve.part))} - row.{'.'.join(field(curve.less))}"
        fields.setdefault(name, []).append(f"{element}: {value}")
    if not fields:
        return {}
    types = {name: [f"{part.partition(':')[0]}: number" for part in parts] for name, parts in fields.items()}
    source = "\n".join(
        [
            'import { Input } from "./types";',
            "",
            "type Output = {",
            *(f"  {name}: {{ {'; '.join(parts)} }};" for name, parts in types.items()),
            "};",
            "",
            f'export const inputs = ["{topic}"];',
            f'export const output = "{SCRIPT_TOPIC}";',
            "",
            f'export default function script(event: Input<"{topic}">): Output {{',
            "  const row = event.message;",
            "  return {",
            *(f"    {name}: {{ {', '.join(parts)} }}," for name, parts in fields.items()),
            "  };",
            "}",
            "",
        ]
    )
    return {"differences": {"name": SCRIPT_TOPIC, "sourceCode": source}}


def _stacked(ids: Sequence[str]) -> Any:
    """Return panels below one another, of one height."""
    if len(ids) == 1:
        return ids[0]
    return _split("column", 100.0 / len(ids), ids[0], _stacked(ids[1:]))


def _split(direction: str, percentage: float, first: Any, second: Any) -> dict[str, Any]:
    return {"direction": direction, "splitPercentage": round(percentage, 2), "first": first, "second": second}


def _identifier(title: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in title.lower())
