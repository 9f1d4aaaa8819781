"""Whole campaigns: the same table for any number of workers and any interruption; tables, page and JSON."""

import json
import random
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.cli import main
from hil.record.figures import figures
from hil.record.log import Log
from hil.study.campaign import parquet
from hil.study.campaign import row as row_of
from hil.study.campaign.command import run_campaign
from hil.study.campaign.figures import METRICS
from hil.study.campaign.plan import identity, read_plan
from hil.study.campaign.rerun import rerun
from hil.study.campaign.row import run_row
from hil.study.campaign.show import rerun_command, write_page
from hil.study.campaign.store import Store
from tests.hil.study.campaign.campaigns import MANY, SMALL, kill_thrice, written


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A campaign of four rows that has run in this process, its folder and its summary."""
    folder = tmp_path_factory.mktemp("campaign")
    plan = read_plan(written(folder, SMALL))
    return plan, folder / "results", run_campaign(plan, folder / "results", jobs=1)


def test_campaign_row_contains_its_axis_values_and_its_outcome(small):
    plan, folder, summary = small
    rows = pq.read_table(folder / "table.parquet").to_pylist()
    assert rows == summary["matrix"]
    assert [row["fault"] for row in rows] == ["none", "jump"] * 2
    assert [row["friction_N"] for row in rows] == [plan.values(k)["friction_N"] for k in range(4)]
    assert [(row["passed"], row["ended"], row["faults"]) for row in rows] == [
        (True, "complete", ""), (False, "fault", "ENCODER")
    ] * 2  # fmt: skip
    assert "leg 1" in rows[1]["trouble"]
    assert rows[1]["ended_s"] < rows[0]["ended_s"] - 0.3, "the jump is at the release of the brakes"
    assert rows[0]["tracked_s"] == pytest.approx(0.05)
    assert (summary["rows"], summary["failed"], summary["success"]) == (4, 2, False)
    assert summary["failed_interval_percent"] == pytest.approx([15.0, 85.0], abs=0.1)


def test_an_interrupted_campaign_continues_to_the_same_table(small, tmp_path):
    plan, folder, _ = small

    def press(done, _):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(
        KeyboardInterrupt, match=r"with 2 of 4 rows in .*; the same command continues from there"
    ):
        run_campaign(plan, tmp_path, jobs=1, progress=press)
    seen = []
    summary = run_campaign(plan, tmp_path, jobs=2, progress=lambda *counts: seen.append(counts))
    assert (summary["rows_kept"], summary["rows_run"]) == (2, 2)
    assert seen == [(2, 4), (3, 4)]
    assert (tmp_path / "table.parquet").read_bytes() == (folder / "table.parquet").read_bytes()
    again = run_campaign(plan, tmp_path, jobs=1)
    assert again["rows_run"] == 0
    assert again["matrix"] == summary["matrix"]


def test_repeated_campaign_row_and_its_log_give_bitwise_equal_figures(small, tmp_path):
    plan, folder, summary = small
    with pytest.raises(ConfigurationError, match="row 4: allowed: 0 to 3"):
        rerun(plan, folder, 4, None)
    found = rerun(plan, folder, 0, tmp_path / "row.mcap")
    assert found["success"], found["trouble"]
    assert found["compared_with"] == "the stored row"
    row = summary["matrix"][0]
    log = figures(Log(tmp_path / "row.mcap").rows())["tracking"]  # the figures of `hil sim`
    for name in (
        "peak_leg_error_mm",
        "rms_leg_error_mm",
        "peak_position_error_mm",
        "peak_rotation_error_deg",
    ):
        assert log[name] == pytest.approx(row[name], rel=1e-12)


def test_rerun_reports_a_difference_of_one_bit_to_the_stored_figure(small, tmp_path):
    plan, _, summary = small
    rows = [dict(row) for row in summary["matrix"]]
    rows[2]["peak_force_N"] = float(np.nextafter(rows[2]["peak_force_N"], np.inf))
    columns = parquet.columns(plan)
    with closing(Store(tmp_path, columns, identity(plan))) as running:
        for row in rows:
            running.add(row)
        found = rerun(plan, tmp_path, 2, None)  # while the campaign is running
    assert (found["success"], found["different"]) == (False, 1)
    assert "peak_force_N of run again" in found["trouble"]


def test_campaign_run_ends_as_soon_as_it_exceeds_a_limit(small, tmp_path):
    text = SMALL.replace("0.05", "0.5") + "limits: {peak_true_leg_error_mm: {max: 1e-4}}\n"
    plan = read_plan(written(tmp_path, text))
    row = run_row(plan.job(0))
    assert (row["passed"], row["ended"], row["faulted"]) == (False, "limit", 0)
    assert row["peak_true_leg_error_mm"] > 1e-4
    assert row["tracked_s"] < 0.15  # limits are judged every 100 ticks
    assert small[2]["matrix"][0]["passed"]


def test_campaign_row_with_an_invalid_combination_of_values_fails_with_the_reason(tmp_path):
    """The path needs 0.847 m: each value alone allows it, both together do not."""
    text = """
    kind: campaign
    duration_s: 0.05
    grid:
      least_m: {key: platform.length_min_m, values: [0.75, 0.82]}
      margin_m: {key: limits.stroke_margin_m, values: [0.02, 0.08]}
    """
    row = run_row(read_plan(written(tmp_path, text)).job(3))
    first = read_plan(written(tmp_path, text.replace("[0.75, 0.82]", "[0.82, 0.75]")))
    assert identity(first) != {}  # although margin_m 0.08 does not go with the first value of least_m
    assert (row["passed"], row["ended"]) == (False, "refused")
    assert "out of reach, allowed leg lengths: 0.9 to" in row["trouble"]
    assert "with the changes of" not in row["trouble"]  # a place in a text that nobody has, and where it lies
    assert {row[name] for name in METRICS} == {None}


def test_exception_of_a_law_fails_only_its_campaign_row_and_is_reproducible(small, tmp_path, monkeypatch):
    def diverging(*_):
        raise ValueError("array must not contain infs or NaNs")

    monkeypatch.setattr(row_of, "run", diverging)
    plan = small[0]
    row = run_campaign(plan, tmp_path, jobs=1)["matrix"][2]
    assert (row["passed"], row["ended"]) == (False, "error")
    assert row["trouble"] == "ValueError: array must not contain infs or NaNs"
    assert rerun(plan, tmp_path, 2, None)["success"]
    with pytest.raises(ConfigurationError, match=r"row 2: ValueError: .* no run to record"):
        rerun(plan, tmp_path, 2, tmp_path / "row.mcap")


def test_campaign_rows_with_until_parked_and_after_fault_rest_run_to_standstill(tmp_path):
    text = SMALL.replace("duration_s: 0.05", "duration_s: 0.05\nuntil: parked\nafter_fault: rest")
    plan = read_plan(written(tmp_path, text))
    parked, stopped = run_row(plan.job(0)), run_row(plan.job(1))
    assert (parked["passed"], parked["ended"], parked["travel_mm"]) == (True, "complete", 0.0)
    assert 1.5 < parked["ended_s"] < 5.0  # the whole path takes 20 s
    assert stopped["ended"] == "fault"
    assert 0.0 < stopped["travel_mm"] < 10.0


def test_the_page_loads_nothing_and_lists_commands_for_the_worst_rows(small, tmp_path):
    plan, _, summary = small
    write_page(tmp_path / "page.html", plan, summary, tmp_path / "<out>")
    text = (tmp_path / "page.html").read_text()
    assert "script-src 'none'" in text
    assert "<script" not in text
    assert "http" not in text.replace("http-equiv", "")
    for word in ("2 of 4 rows failed: 50 %", "friction_N", "34.2 to 100.0", "ENCODER"):
        assert word in text
    command = rerun_command(plan, 1, tmp_path / "<out>")
    assert command.startswith("hil campaign rerun ")
    assert command.replace("<", "&lt;").replace(">", "&gt;").replace("'", "&#x27;") in text


def test_the_command_shows_stored_rows_and_writes_junit_and_json(small, tmp_path, monkeypatch):
    """Exit code 1 for failed rows, 2 for invalid input."""
    plan, folder, _ = small
    out = ["--out", str(folder)]
    files = ["--junit", str(tmp_path / "j.xml"), "--json", str(tmp_path / "j.json")]
    result = CliRunner().invoke(main, ["campaign", str(plan.path), *out, *files])
    assert result.exit_code == 1
    assert "campaign: failed" in result.output
    assert f"hil campaign rerun {plan.path} 1 --out {folder} --log" in result.output
    assert "15 to 85 %" in result.output
    assert (folder / "report.html").is_file()
    suite = ET.parse(tmp_path / "j.xml").getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("4", "2")
    cases = suite.findall("testcase")
    assert [case.find("failure") is None for case in cases] == [True, False] * 2
    assert "fault=jump" in cases[1].get("name", "")
    assert json.loads((tmp_path / "j.json").read_text())["failed"] == 2

    result = CliRunner().invoke(main, ["campaign", "rerun", str(plan.path), "0", *out])
    assert result.exit_code == 0, result.output

    changed = written(tmp_path, SMALL.replace("seed: 3", "seed: 4"))
    result = CliRunner().invoke(main, ["campaign", str(changed), *out])
    assert (result.exit_code, "these parts differ: campaign, values of the rows" in result.stderr) == (
        2,
        True,
    )
    monkeypatch.chdir(tmp_path)
    (tmp_path / "payload").mkdir()
    assert len(read_plan(Path("payload"))) == 500  # the shipped one, whatever folder has that name
    result = CliRunner().invoke(main, ["campaign", "nosuch"])
    assert (result.exit_code, "campaign; shipped: builds, payload, wear" in result.stderr) == (2, True)


@pytest.mark.long
def test_the_table_is_the_same_after_kill_9_at_three_random_instants(tmp_path):
    plan = read_plan(written(tmp_path, MANY))
    run_campaign(plan, tmp_path / "whole", jobs=2)
    kill_thrice(plan, tmp_path / "killed", random.Random(1), "--jobs", "2")
    summary = run_campaign(plan, tmp_path / "killed", jobs=1)
    assert 0 < summary["rows_kept"] < 80
    assert [row["row"] for row in summary["matrix"]] == list(range(80))
    tables = [(tmp_path / name / "table.parquet").read_bytes() for name in ("killed", "whole")]
    assert tables[0] == tables[1]
