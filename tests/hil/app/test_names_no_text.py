"""A file whose name is no UTF-8: what names it in a log, a report or a page is written all the same."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml

from drivers.errors import ConfigurationError, PlantError
from drivers.signals import Fault, Mode
from hil.app.configuration.configuration import load
from hil.app.configuration.section_file import write_section
from hil.app.files import write_whole
from hil.app.new.command import new_configuration, recognised
from hil.app.output import closing
from hil.config.running import WebsocketSettings
from hil.lab.identify import payload_block
from hil.loop.run_end import Ending
from hil.record import Recording
from hil.record.log import Log
from hil.record.schema import IDENTITY, SUMMARY
from hil.study.junit import Verdict, write_junit
from tests.hil.app.test_new_derived import answered
from tests.hil.samples import random_ticks, record

NAMES = [os.fsdecode(b"caf\xe9.yaml"), "caf\ud800.yaml", "caf\udfff.yaml"]
ODD = pytest.mark.parametrize("name", NAMES, ids=ascii)


@ODD
def test_a_log_holds_events_reason_and_description_that_name_such_a_file(tmp_path, name):
    path = tmp_path / "a.mcap"
    said = f"no drive answered: start `hil plant {name}` first"
    options = {"kind": "sim", "what_if_of": name, "files": [name]}
    recording = Recording.start(path, configuration="", lockstep=True, metadata=options)
    recording.event(0, "error", said)
    record(recording, random_ticks(3))
    recording.event(0, "error", "x" * 150 + said)  # longer than one piece
    closed = recording.close(closing(Ending(Mode.WAITING, Fault.NONE, said, 2), said))
    assert (closed.error, closed.ticks) == ("", 3)
    log = Log.open(path)
    plain = said.replace(name, "caf?.yaml")
    texts = [event.text for event in log.events()]
    assert texts == [plain, "x" * 150 + plain]
    assert log.metadata[SUMMARY]["reason"] == plain
    assert log.metadata[IDENTITY]["what_if_of"] == "caf?.yaml"


@ODD
def test_a_text_file_holds_what_names_such_a_file(tmp_path, name):
    write_whole(tmp_path / "a.md", f"configuration {name}, \u2013 \xe9\n")
    assert (tmp_path / "a.md").read_text("utf-8") == "configuration caf?.yaml, \u2013 \xe9\n"


BESIDE = [*NAMES, "a\nname: other\nb.yaml", "a\u2028b.yaml", "a\x1b[31mb.yaml"]
COMMENT = pytest.mark.parametrize("name", BESIDE, ids=ascii)


@COMMENT
def test_a_new_configuration_may_stand_in_a_file_of_any_name(tmp_path, name):
    text, c = new_configuration(answered(), tmp_path / name)
    assert not {"name", "other"} & {line.partition(":")[0] for line in text.split("\n\n")[0].split("\n")}
    write_whole(tmp_path / "r.yaml", text)
    assert load(tmp_path / "r.yaml").model_dump() == c.model_dump()


@COMMENT
def test_the_remark_of_a_section_in_its_file_is_one_line_whatever_it_names(tmp_path, name):
    write_section(tmp_path / "axes.yaml", WebsocketSettings(), f"Made for {name}")
    lines = (tmp_path / "axes.yaml").read_text("utf-8").split("\n")
    assert lines[0].startswith("# Made for ")
    assert lines[1:] == ["{host: 127.0.0.1, port: 8765}", ""]


@COMMENT
def test_a_payload_found_in_logs_of_any_name_is_a_file_of_yaml(monkeypatch, name):
    monkeypatch.setattr(payload_block, "block", lambda _: {"payload": 7})
    found: Any = SimpleNamespace(sources=[SimpleNamespace(path=name)])
    assert yaml.safe_load(payload_block.file_text(found)) == {"payload": 7}


@pytest.mark.parametrize("name", [NAMES[0], "a\x1b[31m.fmu"], ids=ascii)
def test_an_fmu_that_no_configuration_can_name_is_refused_before_anything_is_asked(tmp_path, name):
    with pytest.raises(ConfigurationError, match="no configuration can name it; rename it"):
        recognised(tmp_path / name, tmp_path)
    with pytest.raises(PlantError):
        recognised(tmp_path / "caf\xe9.fmu", tmp_path)


@ODD
def test_a_report_for_a_server_names_such_a_file_and_parses(tmp_path, name):
    write_junit(tmp_path / "a.xml", f"hil faults {name}", [Verdict(name, name, f"{name} failed")])
    suite = ET.parse(tmp_path / "a.xml").getroot()
    assert (suite.get("name") or "").startswith("hil faults caf")
    assert suite.get("failures") == "1"
