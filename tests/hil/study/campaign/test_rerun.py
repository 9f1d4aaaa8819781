"""A row again: what is recorded of it, and what its figures are compared with, or that nothing is stored."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from hil.cli import main
from hil.study.campaign import rerun
from hil.study.campaign.command import line
from hil.study.campaign.parquet import columns
from hil.study.campaign.plan import identity, read_plan
from hil.study.campaign.row import Ended, run_row
from hil.study.campaign.store import Store
from tests.hil.study.campaign.campaigns import SMALL, written


@pytest.mark.parametrize(
    ("ticks", "stop_tick", "duration_s"), [(700, None, 1.4), (700, 300, 0.6), (250, 0, 0.0)]
)
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_a_row_is_recorded_with_its_own_chance_and_parks_when_it_did(
    monkeypatch: pytest.MonkeyPatch, ticks: int, stop_tick: int | None, duration_s: float, seed: int
) -> None:
    ran: list[dict[str, Any]] = []
    monkeypatch.setattr(rerun, "simulate", lambda _, **given: ran.append(given))
    c: Any = SimpleNamespace(loop=SimpleNamespace(rate_Hz=500.0))
    job: Any = SimpleNamespace(seed=seed)
    rerun._simulate(c, job, Ended("complete", "", ticks, stop_tick), Path("a.mcap"))
    (given,) = ran
    assert given["duration_s"] == pytest.approx(duration_s, abs=1e-12)
    assert (given["faults"].faults, given["faults"].seed) == ((), seed)
    assert given["plant_log"]


@pytest.fixture
def plan(tmp_path, monkeypatch):
    """A campaign of four rows of which none is stored, in the folder where the command is given."""
    monkeypatch.chdir(tmp_path)
    return read_plan(written(tmp_path, SMALL))


def again(*words):
    """Return what `hil campaign rerun` of its row 2 ends with."""
    return CliRunner().invoke(main, ["campaign", "rerun", "c.yaml", "2", *words])


ELSEWHERE = (
    "--out mistyped: row 2 of c.yaml is not stored there; name the folder of its results, or run "
    "`hil campaign` first"
)
NOT_YET = (
    "runs/small-campaign: row 2 of c.yaml is not stored there; name the folder of its results with --out, run "
    "`hil campaign` first, or add --log to record the row alone"
)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--out", "mistyped"], ELSEWHERE),
        (["--out", "mistyped", "--log", "row.mcap"], ELSEWHERE),
        ([], NOT_YET),
    ],
    ids=["out", "out and log", "default place"],
)
def test_a_row_that_has_nothing_to_be_compared_with_is_refused_before_it_runs(plan, monkeypatch, words, said):
    ran: list[Any] = []
    monkeypatch.setattr(rerun, "performed", ran.append)
    found = again(*words)
    assert (found.exit_code, found.stderr, found.stdout) == (2, f"hil: {said}\n", "")
    assert ran == []
    assert [path.name for path in Path().iterdir()] == ["c.yaml"]


def test_a_campaign_that_has_not_come_to_the_row_has_nothing_to_compare_it_with(plan, monkeypatch):
    monkeypatch.setattr(rerun, "performed", None)
    with Store(Path("begun"), columns(plan), identity(plan)) as running:
        running.add(line(plan, run_row(plan.job(0)), columns(plan)))
    found = again("--out", "begun")
    assert (found.exit_code, "--out begun: row 2 of c.yaml is not stored there" in found.stderr) == (2, True)


def test_a_row_recorded_alone_says_that_no_row_is_stored_and_counts_no_differences(plan):
    found = again("--log", "row.mcap", "--json", "a.json")
    assert found.exit_code == 0, found.output
    shown = " ".join(found.stdout.split())
    assert "compared with nothing: no row is stored in runs/small-campaign" in shown
    assert "different" not in shown
    values = json.loads(Path("a.json").read_text())
    assert (values["success"], values["different"]) == (True, None)
    assert Path("row.mcap").is_file()
