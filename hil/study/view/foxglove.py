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


def layout(columns: Sequence[Column], topic: str) -> str:
    """Layout for logs with these columns as JSON."""
    panels: dict[str, Any] = json.loads(_asset("foxglove-panels.json").replace("TOPIC", topic))
    plain = panels.pop("Plot")
    first = [c for c in columns if c.name in ("mode", "command_mode") and c.names]
    panels["StateTransitions!mode"] = _transitions("Mode", _enumerated(first, topic))
    pages: dict[str, list[str]] = {}
    for plot in plots(columns):
        place = f"Plot!{_identifier(plot.title)}"
        paths = [_path(curve_path(topic, curve), curve.title, enabled=True) for curve in plot.curves]
        panels[place] = plain | {"foxglovePanelTitle": plot.title, "paths": paths}
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


def _asset(name: str) -> str:
    return importlib.resources.files("hil.study.view").joinpath(name).read_text("utf-8")


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
    """Title -> label and message path of each state: enumerations together, flags by column."""
    flags = [c for c in states(columns) if issubclass(c.type, IntFlag)]
    found = {"States": _enumerated([c for c in states(columns) if c not in flags], topic)}
    for c in flags:
        title = c.name.replace("_", " ").capitalize()
        found[title] = [(name, f"{topic}.{c.name}.{name}") for name in c.names]
    return {title: lanes for title, lanes in found.items() if lanes}


def _enumerated(columns: Sequence[Column], topic: str) -> list[tuple[str, str]]:
    return [(label, f"{topic}.{label}") for c in columns for label in c.labels]


def _path(value: str, label: str, **more: bool) -> dict[str, Any]:
    return {"value": value, "label": label, **more, "timestampMethod": "receiveTime"}


def _transitions(title: str, lanes: Sequence[tuple[str, str]]) -> dict[str, Any]:
    paths = [_path(path, label) for label, path in lanes]
    return {"foxglovePanelTitle": title, "isSynced": True, "paths": paths}


def _scripts(columns: Sequence[Column], topic: str) -> dict[str, Any]:
    """User script that makes the differences; none where there are none."""
    fields: dict[str, dict[str, str]] = {}
    for curve in differences(columns):
        assert curve.less is not None
        name, element = _difference(curve)
        value = f"row.{'.'.join(field(curve.part))} - row.{'.'.join(field(curve.less))}"
        fields.setdefault(name, {})[element] = value
    if not fields:
        return {}
    types = [f"  {name}: {{ {'; '.join(f'{x}: number' for x in parts)} }};" for name, parts in fields.items()]
    sums = [
        f"    {name}: {{ {', '.join(f'{x}: {y}' for x, y in parts.items())} }},"
        for name, parts in fields.items()
    ]
    filled = {"TOPIC": topic, "OUTPUT": SCRIPT_TOPIC, "TYPES": "\n".join(types), "VALUES": "\n".join(sums)}
    source = _asset("foxglove-script.ts")
    for word, text in filled.items():
        source = source.replace(word, text)
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
