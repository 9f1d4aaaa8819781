"""Layouts for Foxglove, Lichtblick and PlotJuggler: each name is in the log, with a type that can be drawn."""

import json
import re
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from click.testing import CliRunner
from google.protobuf import descriptor_pb2, descriptor_pool
from mcap.reader import make_reader

from hil.cli import main
from hil.record import Recording
from hil.record.log import Log
from hil.record.row import TICKS
from hil.study.log_columns import plots
from hil.study.view.command import view
from tests.hil.samples import random_ticks, record

LAYOUTS = Path(__file__).parents[3] / "configs" / "viewers"
SCRIPT_TOPIC = "/studio_script/differences"
DOUBLE, BOOL, ENUM = 1, 8, 14
NUMBERS = {DOUBLE, 2, 3, 7, BOOL, 13, 16}
"""Numeric field types of protobuf."""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    with Recording.start(path, configuration="", lockstep=True) as recording:
        record(recording, random_ticks(40, seed=1))
    return path


@pytest.fixture(scope="module")
def log(path):
    return Log(path)


def messages(path):
    """Topic -> protobuf descriptor, as a viewer reads them from the file."""
    found = {}
    with Path(path).open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        pool = descriptor_pool.DescriptorPool()
        for one in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
            pool.Add(one)
        found[channel.topic] = pool.FindMessageTypeByName(schema.name)
    return found


def kind_at(descriptor, names):
    """Type of the value at a list of field names, `x[3]` for repeated fields; None: no such field."""
    for k, name in enumerate(names):
        plain, indexed, _ = name.partition("[")
        field = descriptor.fields_by_name.get(plain)
        if field is None or field.is_repeated != bool(indexed):
            return None
        if k == len(names) - 1:
            return field.type
        descriptor = field.message_type
        if descriptor is None:
            return None
    return None


def resolve(found, value):
    """Type of the value at a message path of Foxglove."""
    topic = next((t for t in found if value.startswith(f"{t}.")), None)
    return topic and kind_at(found[topic], value[len(topic) + 1 :].split("."))


def parts():
    content = json.loads((LAYOUTS / "foxglove.json").read_text())
    return content, content["configById"]


def test_each_path_of_a_foxglove_plot_is_a_number_in_the_log(log):
    found = messages(log.path)
    content, panels = parts()
    paths = [p["value"] for name, c in panels.items() if name.startswith("Plot!") for p in c["paths"]]
    assert len(paths) > 40
    script = "".join(s["sourceCode"] for s in content["userNodes"].values())
    for value in paths:
        if value.startswith(SCRIPT_TOPIC):
            name, element = value[len(SCRIPT_TOPIC) + 1 :].split(".")
            assert re.search(rf"{name}: {{.*\b{element}: row\.", script), value
            assert re.search(rf"{name}: {{.*\b{element}: number", script), value
        else:
            assert resolve(found, value) in NUMBERS, value
    sources = re.findall(r"row\.([\w.\[\]]+)", script)
    assert len(sources) == 2 * 9
    assert {resolve(found, f"{log.topic}.{source}") for source in sources} == {DOUBLE}


def test_each_state_of_the_foxglove_layout_has_names_in_the_log(path):
    found = messages(path)
    _, panels = parts()
    lanes = {p["value"] for name, c in panels.items() if name.startswith("StateT") for p in c["paths"]}
    assert {resolve(found, value) for value in lanes} == {ENUM, BOOL}
    named = {c.name for c in TICKS.columns if c.names}
    assert {value.split(".")[1] for value in lanes} == named, "the layout has every column of named values"
    assert {"/tick.mode", "/tick.drive_state.leg_5", "/tick.faults.STALE"} <= lanes


def test_every_panel_of_the_foxglove_layout_is_shown_once():
    content, panels = parts()
    shown = []

    def walk(node):
        if isinstance(node, str):
            shown.append(node)
        else:
            assert node["direction"] in {"row", "column"}
            assert 0 < node["splitPercentage"] < 100
            walk(node["first"])
            walk(node["second"])

    walk(content["layout"])
    for tab in panels["Tab!columns"]["tabs"]:
        walk(tab["layout"])
    assert sorted(shown) == sorted(panels)
    assert {name.split("!")[0] for name in shown} >= {"3D", "Plot", "Tab", "RosOut", "RawMessages"}


def names_in_plotjuggler(descriptor, prefix):
    """Number series that PlotJuggler's protobuf reader makes of a message: fields joined by `/`."""
    for field in descriptor.fields:
        name = f"{prefix}/{field.name}"
        if field.is_repeated:
            yield from (f"{name}[{i}]" for i in range(9))
        elif field.message_type is not None:
            yield from names_in_plotjuggler(field.message_type, name)
        elif field.enum_type is None:  # an enumeration is a series of texts, which no plot draws
            yield name


def test_each_plotjuggler_curve_is_a_number_in_the_log_or_a_difference(log):
    there = set(names_in_plotjuggler(messages(log.path)[log.topic], log.topic))
    root = ET.parse(LAYOUTS / "plotjuggler.xml").getroot()
    made = set()
    for snippet in root.iter("snippet"):
        sources = {snippet.findtext("linked_source"), snippet.findtext("additional_sources/v1")}
        assert len(sources) == 2
        assert sources <= there
        assert snippet.findtext("function") == "return value - v1"
        made.add(snippet.get("name"))
    for splitter in root.iter("DockSplitter"):
        assert splitter.attrib["count"] == str(len(splitter.findall("DockArea/plot")))
    curves = [curve.get("name") for curve in root.iter("curve")]
    assert len(curves) > 40
    assert set(curves) <= there | made
    assert made <= set(curves)


def test_plotjuggler_opens_only_the_row_topic_of_the_log(path, tmp_path):
    view(path, "plotjuggler", out=tmp_path / "a.xml", start=False)
    root = ET.parse(tmp_path / "a.xml").getroot()
    (file,) = root.findall("previouslyLoaded_Datafiles/fileInfo")
    (parameters,) = file.findall("plugin[@ID='DataLoad MCAP']/parameters")
    assert file.get("filename") == str(path)
    assert parameters.get("selected_topics") == "/tick"


def test_both_layouts_have_every_plot_of_the_report():
    titles = {plot.title for plot in plots(TICKS.columns)}
    assert titles <= {panel.get("foxglovePanelTitle") for panel in parts()[1].values()}
    docks = ET.parse(LAYOUTS / "plotjuggler.xml").getroot().iter("DockArea")
    assert titles <= {str(dock.get("name")).partition(" [")[0] for dock in docks}


def hil(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.mark.parametrize(
    ("viewer", "program", "suffix", "words"),
    [
        ("plotjuggler", "plotjuggler", "-plotjuggler.xml", "-n -l {file}"),
        ("foxglove", "lichtblick", "-foxglove.json", "{log}"),
        ("foxglove", "foxglove-studio", "-foxglove.json", "{log}"),
    ],
)
def test_hil_view_starts_the_viewer_with_its_file(
    path, tmp_path, monkeypatch, viewer, program, suffix, words
):
    told = tmp_path / "told"
    fake = tmp_path / program
    fake.write_text(f'#!/bin/sh\nprintf %s "$*" > {told}\n')
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin")
    log = tmp_path / "run.mcap"
    log.write_bytes(path.read_bytes())
    done = hil("view", log, "--with", viewer)
    assert done.exit_code == 0, done.output
    file = tmp_path / f"run{suffix}"
    assert file.stat().st_size > 1000
    assert told.read_text().strip() == words.format(file=file, log=log)
    assert hil("view", log, "--with", viewer).exit_code == 0, "a second time, too"


def test_a_viewer_that_fails_or_is_missing_is_reported(path, tmp_path, monkeypatch):
    fake, out = tmp_path / "plotjuggler", tmp_path / "a.xml"
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin")
    done = hil("view", path, "--with", "plotjuggler", "--out", out)
    assert (done.exit_code, "plotjuggler -n -l" in done.output) == (0, True)
    fake.write_text("#!/bin/sh\nexit 3\n")
    fake.chmod(0o755)
    assert hil("view", path, "--with", "plotjuggler", "--out", out).exit_code == 2, "not overwritten"
    done = hil("view", path, "--with", "plotjuggler", "--out", out, "--force")
    assert (done.exit_code, "exit code 3" in done.output) == (1, True)


def test_hil_view_without_rerun_reports_the_package_to_install(path, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    done = hil("view", path, "--out", tmp_path / "a.rrd")
    assert (done.exit_code, "hexapod-hil[viewers]" in done.output) == (2, True)
    assert list(tmp_path.iterdir()) == []
