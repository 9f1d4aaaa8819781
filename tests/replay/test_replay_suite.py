"""A folder of logs replayed as one suite; and options of replay that exclude each other."""

from __future__ import annotations

import json
import shutil
from xml.etree import ElementTree as ET

import pytest
from click.testing import CliRunner

import hil
from hil.cli import main
from hil.study import replay_suite
from hil.study.replay_suite import logs_in, replay_case, run_suite
from tests.hil.rewrite import rewrite_log

ONE = "exclude each other: give one of them"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("suite") / "run.mcap"
    hil.sim("virtual", duration_s=0.1, log=path, check_replay=False)
    return path


@pytest.fixture
def folder(log, tmp_path):
    """Logs of every kind: complete, of a plant, cut, with a missing frame; one in a subfolder."""
    there = tmp_path / "runs"
    (there / "below").mkdir(parents=True)
    shutil.copy(log, there / "below" / "good.mcap")
    shutil.copy(log.with_name("run-plant.mcap"), there / "good-plant.mcap")
    (there / "cut.mcap").write_bytes(log.read_bytes()[:-3000])
    rewrite_log(
        log, there / "other.mcap", lambda topic, data, n: None if (topic, n) == ("/can", 40) else data
    )
    (there / "notes.txt").write_text("no log")
    return there


def suite(folder, *words):
    return CliRunner().invoke(main, ["replay", "--suite", str(folder), "--jobs", "1", *map(str, words)])


def test_replay_suite_reports_every_log_of_a_folder_despite_bad_logs(folder, tmp_path):
    result = suite(folder, "--json", tmp_path / "a.json", "--junit", tmp_path / "a.xml")
    assert result.exit_code == 1, result.output
    found = json.loads((tmp_path / "a.json").read_text())
    assert (found["logs"], found["passed"], found["failed"], found["skipped"]) == (4, 1, 2, 1)
    cases = {case["log"].removeprefix(f"{folder}/"): case for case in found["cases"]}
    assert {name: case["verdict"] for name, case in cases.items()} == {
        "below/good.mcap": "pass",
        "cut.mcap": "fail",
        "good-plant.mcap": "skipped",
        "other.mcap": "fail",
    }
    assert cases["cut.mcap"]["text"].startswith("cut at ")
    assert "'plant'" in cases["good-plant.mcap"]["text"]
    assert cases["other.mcap"]["summary"]["different_ticks"] >= 1
    assert all(name in result.stdout for name in cases)
    root = ET.parse(tmp_path / "a.xml").getroot()
    assert (root.get("tests"), root.get("failures")) == ("4", "2")
    failed = {case.get("name"): case.find("failure") is not None for case in root}
    assert failed == {"good.mcap": False, "cut.mcap": True, "good-plant.mcap": False, "other.mcap": True}
    (good,) = [case for case in root if case.get("name") == "good.mcap"]
    assert good.get("classname") == "below"


@pytest.mark.parametrize(
    ("place", "message"),
    [("nowhere", "no such folder"), ("empty", "has no file *.mcap"), ("plants", "only 1 of other kinds")],
)
def test_folder_without_logs_to_replay_is_an_error(folder, place, message):
    (folder / "empty" / "folder.mcap").mkdir(parents=True)
    (folder / "plants").mkdir()
    shutil.move(folder / "good-plant.mcap", folder / "plants")
    result = suite(folder / place)
    assert result.exit_code == 2, result.output
    assert message in result.stderr


def test_interrupt_prints_the_table_of_finished_logs(folder, monkeypatch):
    def interrupted(path):
        if path.name == "cut.mcap":
            raise KeyboardInterrupt
        return replay_case(path)

    monkeypatch.setattr(replay_suite, "replay_case", interrupted)
    result = suite(folder)
    assert result.exit_code == 130, result.output
    assert "below/good.mcap" in result.stdout
    assert "interrupted with 1 of 4 logs replayed" in result.stderr


@pytest.mark.long
def test_replay_suite_gives_equal_results_with_one_and_two_processes(folder):
    found = [
        sorted((case.log, case.verdict, case.text) for case in run_suite(logs_in(folder), jobs, None))
        for jobs in (1, 2)
    ]
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.mcap", "--what-if", "virtual", "--against", "b.mcap"], f"--what-if and --against {ONE}"),
        (["--suite", ".", "--set", "limits.force_N=1"], f"--set and --suite {ONE}"),
        (["a.mcap", "--against", "b.mcap", "--suite", "."], f"--against and --suite {ONE}"),
        (["a.mcap", "--tolerance", "tau=1"], "--tolerance needs --against"),
        (["a.mcap", "--junit", "a.xml"], "--junit needs --suite"),
        (["a.mcap", "--log", "b.mcap"], "--log needs --what-if CONFIG or --set KEY=VALUE"),
        (["a.mcap", "--against", "b.mcap", "--log", "c.mcap"], "--log needs --what-if CONFIG"),
        (["a.mcap", "--suite", "."], "--suite takes a folder and no LOG: leave out a.mcap"),
        (["a.mcap", "--against", "b.mcap", "--salvage", "c.mcap"], "the replay of one log, not to --against"),
        ([], "Missing argument 'LOG'"),
    ],
)
def test_conflicting_options_are_refused(words, message):
    result = CliRunner().invoke(main, ["replay", *words])
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
