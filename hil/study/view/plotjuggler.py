"""A layout for PlotJuggler: tabs of plots, and what is one column less another as a custom function.

Source: `xmlLoadState` of MainWindow, PlotDocker, PlotWidget and DataLoadMCAP in PlotJuggler 3.16. Its reader
of protobuf joins topic and fields by `/`, `/tick/tau/leg_3`; it draws numbers, so states stand by number.
"""

import importlib.resources
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

from drivers.files import real_path
from drivers.tick_columns import Column
from hil.record.selection import Component
from hil.study.log_columns import Curve, curves
from hil.study.view.panels import NAMED_FIRST, Plot, differences, field, plots

COLOURS = ("#1f77b4", "#d62728", "#1ac938", "#ff7f0e", "#9467bd", "#17becf", "#f14cc1", "#bcbd22")


def layout(columns: Sequence[Column], topic: str, *, log: Path | None = None) -> str:
    """Layout for logs with these columns as XML; with `log` it opens that file at once."""
    frame = importlib.resources.files("hil.study.view").joinpath("plotjuggler.xml")
    root = ET.fromstring(frame.read_text("utf-8"))  # noqa: S314 - ours
    area, _, files, equations = root
    shown = plots(columns) + _states(columns)
    for k, name in enumerate(dict.fromkeys(plot.tab for plot in shown)):
        tab = ET.Element("Tab", containers="1", tab_name=name)
        area.insert(k, tab)
        members = [plot for plot in shown if plot.tab == name]
        count, share = str(len(members)), ";".join([f"{1.0 / len(members):g}"] * len(members))
        container = ET.SubElement(tab, "Container")
        splitter = ET.SubElement(container, "DockSplitter", orientation="-", count=count, sizes=share)
        for plot in members:
            _dock(splitter, plot, topic)
    if log is None:
        root.remove(files)
    else:
        files[0].set("filename", str(real_path(log)))
        files[0][0][0].set("selected_topics", topic)
    for curve in differences(columns):
        _function(equations, curve, topic)
    ET.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def series(topic: str, part: Component) -> str:
    """Return PlotJuggler's name of a component: `/tick/tau/leg_3`."""
    return "/".join((topic, *field(part)))


def _states(columns: Sequence[Column]) -> list[Plot]:
    shown = [c.name for c in columns if c.name in NAMED_FIRST and c.names]
    return [Plot("States", name, tuple(curves(columns, name))) for name in shown]


def _dock(splitter: ET.Element, plot: Plot, topic: str) -> None:
    units = sorted({curve.unit for curve in plot.curves if curve.unit})
    dock = ET.SubElement(splitter, "DockArea", name=plot.title + (f" [{', '.join(units)}]" if units else ""))
    style = "Steps" if plot.tab == "States" else "Lines"
    area = ET.SubElement(dock, "plot", mode="TimeSeries", style=style, flip_x="false", flip_y="false")
    ET.SubElement(area, "limitY")
    for k, curve in enumerate(plot.curves):
        name = curve.label if curve.less else series(topic, curve.part)
        ET.SubElement(area, "curve", name=name, color=COLOURS[k % len(COLOURS)])


def _function(equations: ET.Element, curve: Curve, topic: str) -> None:
    assert curve.less is not None
    snippet = ET.SubElement(equations, "snippet", name=curve.label, language="lua")
    ET.SubElement(snippet, "global")
    ET.SubElement(snippet, "function").text = "return value - v1"
    ET.SubElement(snippet, "linked_source").text = series(topic, curve.part)
    sources = ET.SubElement(snippet, "additional_sources")
    ET.SubElement(sources, "v1").text = series(topic, curve.less)
