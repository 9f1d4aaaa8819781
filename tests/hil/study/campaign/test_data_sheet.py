"""The data sheet of a drive is one of the files that rows of a campaign name: found from any folder, and never another."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load
from hil.study.campaign.plan import Plan, identity, read_plan
from hil.study.campaign.row import row_configuration, run_row
from tests.drivers.cia402_sheet import sheet
from tests.hil.study.campaign.campaigns import written

CHANGED = """
kind: campaign
configuration: ../robot/own.yaml
duration_s: 0.05
changes: {drives: {options: {eds: drive.eds}}}
grid: {force_N: {key: limits.force_N, values: [9000, 9001]}}
"""
SWEPT = """
kind: campaign
configuration: ../robot/own.yaml
duration_s: 0.05
grid: {sheet: {key: drives.options.eds, values: [drive.eds]}}
"""
FOLDERS = ("here", "robot", "campaign")


@pytest.fixture
def there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the folders are; each has a sheet, and the command is given in `here`."""
    for name in (*FOLDERS, "elsewhere"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "drive.eds").write_text(sheet(), encoding="ascii")
    (tmp_path / "elsewhere" / "drive.eds").write_text(sheet(0x605E), encoding="ascii")
    (tmp_path / "robot" / "own.yaml").write_text(load("virtual-cia402").text)
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path


def read(there: Path, text: str, first: int) -> Plan:
    """Read a campaign whose sheet is in the folders from the one with this number on."""
    for name in FOLDERS[:first]:
        (there / name / "drive.eds").unlink()
    return read_plan(written(there / "campaign", text))


@pytest.mark.parametrize("text", [CHANGED, SWEPT], ids=["changed", "swept"])
@pytest.mark.parametrize("first", range(3), ids=FOLDERS)
def test_a_row_reads_the_sheet_that_the_campaign_found_wherever_the_row_runs(
    there: Path, monkeypatch: pytest.MonkeyPatch, text: str, first: int
) -> None:
    plan = read(there, text, first)
    assert [name for name in identity(plan) if name.startswith("file")] == ["file drive.eds"]
    monkeypatch.chdir(there / "elsewhere")  # as a worker of a cluster; that sheet would be refused
    c = row_configuration(plan.job(0))
    found = Path(str(c.drives.options["eds"]))
    assert found.is_absolute()
    assert found.samefile(there / FOLDERS[first] / "drive.eds")


def test_a_sheet_that_changes_ends_the_campaign_and_is_no_failed_row(there: Path) -> None:
    plan = read(there, CHANGED, 0)
    (there / "here" / "drive.eds").write_text(sheet(0x605E), encoding="ascii")
    with pytest.raises(ConfigurationError, match=r"drive\.eds: has changed since"):
        run_row(plan.job(0))


def test_a_sheet_that_is_nowhere_is_refused_before_any_row(there: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"drives\.options\.eds: no such file"):
        read(there, CHANGED, 3)
