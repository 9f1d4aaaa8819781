"""Repeating a row: recording, comparison with the stored row, and rows that are not stored."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli import main
from hil.study.campaign.plan import read_plan
from tests.hil.study.campaign.campaigns import SMALL, written


@pytest.fixture
def plan(tmp_path, monkeypatch):
    """A campaign of four rows, none of them stored, in the working directory."""
    monkeypatch.chdir(tmp_path)
    return read_plan(written(tmp_path, SMALL))


def again(*words):
    """Result of `hil campaign rerun` of row 2."""
    return CliRunner().invoke(main, ["campaign", "rerun", "c.yaml", "2", *words])


@pytest.mark.parametrize(
    "words", [["--out", "mistyped"], ["--out", "mistyped", "--log", "row.mcap"], []], ids=" ".join
)
def test_a_rerun_without_stored_row_or_recording_is_refused_before_it_runs(plan, words):
    found = again(*words)
    folder = "mistyped" if words else "runs/small-campaign"
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr.startswith(f"hil: {folder}: row 2 of c.yaml is not stored there; give the folder")
    assert [path.name for path in Path().iterdir()] == ["c.yaml"]


def test_a_row_recorded_without_a_stored_row_reports_no_comparison(plan):
    found = again("--log", "row.mcap", "--json", "a.json")
    assert found.exit_code == 0, found.output
    shown = " ".join(found.stdout.split())
    assert "compared with nothing: no row is stored in runs/small-campaign" in shown
    assert "different" not in shown
    values = json.loads(Path("a.json").read_text())
    assert (values["success"], values["different"]) == (True, None)
    assert Path("row.mcap").is_file()
