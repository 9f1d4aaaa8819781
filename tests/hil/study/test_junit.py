"""JUnit XML that CI servers can parse and count."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest

from drivers.errors import LogError
from hil.study.junit import Verdict, check_junit_path, write_junit


def test_junit_report_with_any_characters_is_valid_xml_with_all_cases(tmp_path):
    path = tmp_path / "j.xml"
    cases = [
        Verdict("g", "good", output="fine", wall_s=1.25),
        Verdict("g", 'bad <"&\x1b', "leg 2\x00 < leg 3", "line 1\nline 2"),
        Verdict("h", "bad too", "", wall_s=0.0),
    ]
    write_junit(path, "hil x\x07", iter(cases), 3.5)
    suite = ET.parse(path).getroot()
    assert suite.attrib == {"name": "hil x ", "tests": "3", "failures": "2", "time": "3.500"}
    good, bad, empty = suite
    assert good.attrib == {"classname": "g", "name": "good", "time": "1.250"}
    assert (good.find("failure"), good.findtext("system-out")) == (None, "fine")
    assert bad.attrib == {"classname": "g", "name": 'bad <"& '}
    failure = bad.find("failure")
    assert failure is not None
    assert (failure.get("message"), failure.text) == ("leg 2  < leg 3", "line 1\nline 2")
    assert empty.find("failure") is not None
    assert empty.get("time") == "0.000"
    write_junit(path, "none", [])
    assert ET.parse(path).getroot().attrib == {"name": "none", "tests": "0", "failures": "0"}


def test_junit_report_replaces_only_an_earlier_junit_report(tmp_path):
    check_junit_path(tmp_path / "new.xml")
    write_junit(tmp_path / "old.xml", "old", [])
    check_junit_path(tmp_path / "old.xml")
    (tmp_path / "mine.txt").write_text("mine")
    for path, message in (
        ("mine.txt", "is not a JUnit report"),
        (".", "is a folder"),
        ("no/x.xml", "no folder"),
    ):
        with pytest.raises(LogError, match=message):
            check_junit_path(tmp_path / path)
