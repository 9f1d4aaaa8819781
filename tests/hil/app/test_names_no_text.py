"""A file whose name is no UTF-8: what names it in a log, a report or a page is written all the same."""

from __future__ import annotations

import os
from xml.etree import ElementTree as ET

import pytest

from drivers.signals import Fault, Mode
from hil.app.files import write_whole
from hil.app.junit import Verdict, write_junit
from hil.app.output import closing
from hil.loop.run_end import Ending
from hil.record import Recording
from hil.record.log import Log
from hil.record.schema import IDENTITY, SUMMARY
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


@ODD
def test_a_report_for_a_server_names_such_a_file_and_parses(tmp_path, name):
    write_junit(tmp_path / "a.xml", f"hil faults {name}", [Verdict(name, name, f"{name} failed")])
    suite = ET.parse(tmp_path / "a.xml").getroot()
    assert (suite.get("name") or "").startswith("hil faults caf")
    assert suite.get("failures") == "1"
