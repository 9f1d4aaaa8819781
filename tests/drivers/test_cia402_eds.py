"""Data sheets of CiA 402 drives: which are read, and what a drive may lack."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivers.cia402.eds import check_eds
from drivers.cia402.objects import ABORT_CONNECTION, RATED_TORQUE
from drivers.errors import ConfigurationError
from tests.drivers.cia402_sheet import sheet

TEXT = sheet()


def check(path: Path, data: str | bytes, may_lack: tuple[tuple[int, int], ...] = ()) -> None:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    check_eds(str(path), velocity=True, may_lack=may_lack)


def test_check_of_an_eds_file_lists_all_missing_objects(tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(sheet(), encoding="ascii")
    for velocity in (True, False):
        check_eds(str(path), velocity=velocity)
    text = sheet(0x605E, 0x1801)
    for section, key in (("[6060]", "AccessType=rw"), ("[6077]", "PDOMapping=1")):
        at = text.index(section)
        fixed = {"AccessType=rw": "AccessType=ro", "PDOMapping=1": "PDOMapping=0"}[key]
        text = text[:at] + text[at:].replace(key, fixed, 1)
    path.write_text(text, encoding="ascii")
    lacks = "0x605E:0 .*is missing; .*0x6060:0 .*cannot be written; .*0x6077:0 cannot be mapped"
    for velocity in (True, False):
        with pytest.raises(ConfigurationError) as refused:
            check_eds(str(path), velocity=velocity)
        said = sorted(str(refused.value).partition("lacks objects: ")[2].split("; "))
        found = "; ".join(each for each in said if "0x1801" not in each)
        assert re.search(lacks, found), found
        assert any("0x1801" in each for each in said) == velocity


def test_eds_path_that_is_not_a_file_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="no such file"):
        check_eds(str(tmp_path), velocity=True)


MAKERS = "[2000]\nParameterName=own\n"
"""An object without data type and access type, which a sheet must not lack."""


@pytest.mark.parametrize(
    "data",
    [
        TEXT.encode("utf-8-sig"),
        b"[FileInfo]\nDescription=Servoverst\xe4rker 5\x94\n" + TEXT.encode(),  # Windows-1252
        *(TEXT.replace("[DeviceInfo]", f"[DeviceInfo]\nVendorNumber={n}") for n in ("001", "", "0x", "none")),
        TEXT.replace("Lines=0", "Lines=2\nLine1=x"),
        TEXT + "[DummyUsage]\nDummy0002=0\n",
        TEXT + MAKERS + MAKERS,
        TEXT + TEXT,
        re.sub("(?m)^(?=[A-Z])", "  ", TEXT),
        re.sub("(?m)^[^=\n]+(?==)|sub", lambda found: found[0].upper(), TEXT),
        TEXT.replace("\n", " ; a remark\r\n"),
    ],
)
def test_eds_file_with_errors_outside_the_required_objects_is_accepted(tmp_path, data):
    check(tmp_path / "drive.eds", data)


def test_elements_of_a_compact_array_in_an_eds_file_have_the_access_of_the_array(tmp_path):
    compact = "[1016]\nObjectType=8\nCompactSubObj={}\nDataType=7\nAccessType={}\n"
    check(tmp_path / "drive.eds", sheet(0x1016) + compact.format(2, "rw"))
    for wrong in (compact.format(0, "rw"), compact.format(2, "ro")):
        with pytest.raises(ConfigurationError, match=r"0x1016:1 consumer heartbeat time (is|cannot)"):
            check(tmp_path / "drive.eds", sheet(0x1016) + wrong)


@pytest.mark.parametrize("data", ["ServoDrive 5\n" + TEXT, "\0" * 10_000, TEXT + "=5\n"])
def test_unreadable_eds_file_is_refused_in_one_line_with_file_and_line(tmp_path, data):
    with pytest.raises(ConfigurationError, match=r"drive\.eds cannot be read: .*line") as refused:
        check(tmp_path / "drive.eds", data)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize(
    ("modes", "listed"),
    [
        ("DefaultValue=0x2D", "1, 3, 4, 6"),  # of a public report
        ("DefaultValue=0x3F0025", "1, 3, 6"),  # EPOS 24/5: the upper half is the maker's
        ("DefaultValue=0x3FF\nParameterValue=129", "1, 8"),  # of a DCF the configured value counts
        ("DefaultValue=0x2D\nParameterValue=0x22D", ""),
        ("DefaultValue=0", ""),
        ("DefaultValue=", ""),
    ],
)
def test_drive_without_a_torque_mode_in_its_eds_file_is_refused(tmp_path, modes, listed):
    data = f"{sheet(0x6502)}[6502]\nParameterName=modes\nAccessType=ro\n{modes}\n"
    if not listed:
        check(tmp_path / "drive.eds", data)
        return
    with pytest.raises(ConfigurationError, match=rf"0x6502:0 .* modes {listed}; mode 10"):
        check(tmp_path / "drive.eds", data)


def test_option_replaces_the_missing_rated_torque_or_abort_connection_object_of_an_eds_file(tmp_path):
    path, both = tmp_path / "drive.eds", (RATED_TORQUE, ABORT_CONNECTION)
    check(path, sheet(0x6076, 0x6007), both)
    for index, option, other in ((0x6076, "has_rated_torque", 1), (0x6007, "has_abort_connection", 0)):
        with pytest.raises(ConfigurationError, match=rf"0x{index:X}:0 .*{option}: false"):
            check(path, sheet(index), both[other : other + 1])
