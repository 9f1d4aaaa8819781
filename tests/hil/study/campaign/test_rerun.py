"""A row again: what is recorded of it, and what its figures are compared with, or that nothing is stored."""

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
    """A campaign of four rows of which none is stored, in the folder where the command is given."""
    monkeypatch.chdir(tmp_path)
    return read_plan(written(tmp_path, SMALL))


def again(*words):
    """Return what `hil campaign rerun` of its row 2 ends with."""
    return CliRunner().invoke(main, ["campaign", "rerun", "c.yaml", "2", *words])


@pytest.mark.parametrize(
    "words", [["--out", "mistyped"], ["--out", "mistyped", "--log", "row.mcap"], []], ids=" ".join
)
def test_a_row_that_has_nothing_to_be_compared_with_is_refused_before_it_runs(plan, words):
    found = again(*words)
    folder = "mistyped" if words else "runs/small-campaign"
    assert (found.exit_code, found.stdout) == (2, "")
    assert found.stderr.startswith(f"hil: {folder}: row 2 of c.yaml is not stored there; name the folder")
    assert [path.name for path in Path().iterdir()] == ["c.yaml"]


def test_a_row_recorded_alone_says_that_no_row_is_stored_and_counts_no_differences(plan):
    found = again("--log", "row.mcap", "--json", "a.json")
    assert found.exit_code == 0, found.output
    shown = " ".join(found.stdout.split())
    assert "compared with nothing: no row is stored in runs/small-campaign" in shown
    assert "different" not in shown
    values = json.loads(Path("a.json").read_text())
    assert (values["success"], values["different"]) == (True, None)
    assert Path("row.mcap").is_file()
