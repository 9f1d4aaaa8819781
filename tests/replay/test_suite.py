"""A folder of logs, replayed as one suite; and options that exclude each other."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from click.testing import CliRunner

import hil
from drivers.errors import LogError
from hil.app.replay import summary as values
from hil.cli import main
from hil.loop.replay import Comparison
from hil.record.log import Log
from hil.study import replay_suite
from hil.study.replay_suite import Case, died, logs_in, replay_case, run_suite, summary, verdicts
from tests.hil.rewrite import rewrite_log

ONE = "are different questions: give one of them"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("suite") / "run.mcap"
    hil.sim("virtual", duration_s=0.1, log=path, check_replay=False)
    return path


@pytest.fixture
def folder(log, tmp_path):
    """Logs of every sort: whole, of a plant, cut, with a frame that is gone; one in a folder below."""
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


def test_every_log_is_a_case_and_one_bad_log_is_not_the_end(folder, tmp_path):
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
    for name, case in cases.items():
        assert name in result.stdout
        assert case["text"][:40] in result.stdout
    root = ET.parse(tmp_path / "a.xml").getroot()
    assert (root.get("tests"), root.get("failures")) == ("4", "2")
    failed = {case.get("name"): case.find("failure") is not None for case in root}
    assert failed == {"good.mcap": False, "cut.mcap": True, "good-plant.mcap": False, "other.mcap": True}
    (good,) = [case for case in root if case.get("name") == "good.mcap"]
    assert good.get("classname") == "below"


def test_a_folder_of_good_logs_succeeds(folder):
    result = suite(folder / "below")
    assert result.exit_code == 0, result.output
    assert "good.mcap" in result.stdout


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("nowhere", "no such folder"),
        ("notes.txt", "is a file and no folder"),
        ("empty", "has no file *.mcap"),
        ("plants", "has no log of `hil run` or `hil sim`, but 1 of other kinds"),
    ],
)
def test_a_folder_with_nothing_to_replay_is_no_success(folder, place, message):
    (folder / "empty" / "folder.mcap").mkdir(parents=True)
    (folder / "plants").mkdir()
    shutil.move(folder / "good-plant.mcap", folder / "plants")
    result = suite(folder / place)
    assert result.exit_code == 2, result.output
    assert message in result.stderr


def test_what_is_named_after_a_log_is_none(tmp_path):
    for name in ("b.mcap", "a.mcap", "a.mcap.part", "a.mcap.png", ".mcap", "mcap"):
        (tmp_path / name).write_bytes(b"")
    assert logs_in(tmp_path) == [tmp_path / "a.mcap", tmp_path / "b.mcap"]


def test_a_log_on_which_the_code_itself_fails_is_one_failed_case(folder, monkeypatch):
    def fail(path):
        raise ValueError("a bell \x07 in its name")

    monkeypatch.setattr(replay_suite, "replay_log", fail)
    case = replay_case(folder / "below" / "good.mcap")
    assert (case.verdict, case.text) == ("fail", "ValueError: a bell \\x07 in its name")
    assert case.summary == {}


def test_a_log_that_cannot_be_replayed_is_a_failed_case_without_figures_that_took_its_time(
    tmp_path, monkeypatch
):
    path = tmp_path / "gone.mcap"
    monkeypatch.setattr(
        replay_suite, "time", SimpleNamespace(perf_counter=iter((5.0, 5.25, 7.0, 7.5)).__next__)
    )
    assert replay_case(path) == Case(str(path), "fail", "no such file", {}, 0.25)

    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(replay_suite, "_replayed", full)
    assert replay_case(path) == Case(str(path), "fail", "[Errno 28] No space left on device", {}, 0.5)


@pytest.mark.parametrize(("agrees", "verdict"), [(True, "pass"), (False, "fail")])
def test_a_log_of_another_processor_passes_where_its_replay_agrees_though_not_to_the_bit(
    log, monkeypatch, agrees, verdict
):
    found = Comparison(ticks=5, different_ticks=1)
    said = values(found, 0.1, 0.005) | {"first": ["tick 3: tau[0]: recorded 1.0"], "agrees": agrees}
    assert not said["exact"]
    monkeypatch.setattr(replay_suite, "replay_log", lambda _: (found, said))
    assert replay_case(log).verdict == verdict


def test_an_interrupt_leaves_the_table_of_what_was_done(folder, monkeypatch):
    def interrupted(path):
        if path.name == "cut.mcap":
            raise KeyboardInterrupt
        return replay_case(path)

    monkeypatch.setattr(replay_suite, "replay_case", interrupted)
    result = suite(folder)
    assert result.exit_code == 130, result.output
    assert "below/good.mcap" in result.stdout
    assert "cut.mcap" not in result.stdout
    assert "interrupted with 1 of 4 logs replayed" in result.stderr


@pytest.mark.long
def test_two_processes_find_the_same(folder):
    paths = logs_in(folder)
    found = [
        sorted((case.log, case.verdict, case.text) for case in run_suite(paths, jobs, None))
        for jobs in (1, 2)
    ]
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.mcap", "--what-if", "virtual", "--against", "b.mcap"], f"--what-if and --against {ONE}"),
        (["--suite", ".", "--set", "limits.force_N=1"], f"--set (a what-if) and --suite {ONE}"),
        (["a.mcap", "--set", "a=1", "--against", "b.mcap"], f"--set (a what-if) and --against {ONE}"),
        (
            ["a.mcap", "--what-if", "virtual", "--set", "a=1", "--against", "b.mcap"],
            f"--what-if and --against {ONE}",
        ),
        (["a.mcap", "--set", "a=1", "--align", "tick"], "--align belongs to --against, which is not given"),
        (["a.mcap", "--set", "a=1", "--jobs", "2"], "--jobs belongs to --suite, which is not given"),
        (["a.mcap", "--against", "b.mcap", "--suite", "."], f"--against and --suite {ONE}"),
        (["a.mcap", "--tolerance", "tau=1"], "--tolerance belongs to --against"),
        (["a.mcap", "--align", "motion"], "--align belongs to --against"),
        (["a.mcap", "--jobs", "2"], "--jobs belongs to --suite"),
        (["a.mcap", "--junit", "a.xml"], "--junit belongs to --suite"),
        (["a.mcap", "--plot", "a.png"], "--plot belongs to --what-if CONFIG or --set KEY=VALUE"),
        (["a.mcap", "--against", "b.mcap", "--log", "c.mcap"], "--log belongs to --what-if CONFIG"),
        (["a.mcap", "--suite", "."], "--suite takes a folder, and no LOG beside it: a.mcap"),
        (["a.mcap", "--against", "b.mcap", "--salvage", "c.mcap"], "does not go with --against"),
        (["--suite", ".", "--salvage", "c.mcap"], "does not go with --suite"),
        ([], "Missing argument 'LOG'"),
        (["--what-if", "virtual"], "Missing argument 'LOG'"),
    ],
)
def test_options_of_different_questions_refuse_each_other(words, message):
    result = CliRunner().invoke(main, ["replay", *words])
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())


def test_a_log_at_which_its_process_dies_is_a_failure_of_the_suite(tmp_path):
    killed = died(tmp_path / "killer.mcap")
    good = killed._replace(log=str(tmp_path / "good.mcap"), verdict="pass", text="")
    found = summary(tmp_path, [killed, good], 1.0)
    assert (found["success"], found["passed"], found["failed"], found["skipped"]) == (False, 1, 1, 0)
    (_, case) = verdicts(tmp_path, [killed, good])
    assert (case.name, case.failure) == ("killer.mcap", "its process died")


def test_a_folder_that_cannot_be_read_is_no_empty_one(tmp_path, monkeypatch):
    """Its logs would be missing from a suite that succeeds."""
    closed = tmp_path / "closed"
    closed.mkdir()
    (tmp_path / "good.mcap").touch()
    real = os.scandir

    def scandir(path):
        if Path(path) == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(os, "scandir", scandir)
    with pytest.raises(LogError, match=f"folder {closed}: cannot be read: Permission denied"):
        logs_in(tmp_path)


@pytest.mark.parametrize("told", [None, {"text": "leg 3 is slow", "lines": ["leg 3", "is slow"]}])
def test_a_case_has_the_story_of_the_faults_of_its_log(log, monkeypatch, told):
    story: Any = None if told is None else SimpleNamespace(fields=lambda: told)
    comparison = Comparison(ticks=5, story=story)
    found = values(comparison, 1.0, 2.0) | {"agrees": True}
    monkeypatch.setattr(replay_suite, "replay_log", lambda _: (comparison, found))
    case = replay_case(log)
    assert (case.verdict, case.summary.get("story")) == ("pass", told)
    assert ("story" in case.summary) is (told is not None)


def test_a_suite_says_how_long_it_took_and_how_many_ticks_that_is_a_second(folder, tmp_path, monkeypatch):
    shutil.copy(folder / "below" / "good.mcap", folder / "below" / "again.mcap")
    monkeypatch.setattr(
        "hil.cli.replay_forms.time", SimpleNamespace(perf_counter=iter((70.0, 74.0)).__next__)
    )
    begun = iter(range(100, 140))
    monkeypatch.setattr(replay_suite, "time", SimpleNamespace(perf_counter=lambda: 1.0 * next(begun)))
    suite(folder / "below", "--json", tmp_path / "a.json")
    found = json.loads((tmp_path / "a.json").read_text())
    ticks = len(Log(folder / "below" / "good.mcap").rows())
    assert (found["wall_s"], found["ticks"]) == (4.0, 2 * ticks)
    assert found["ticks_per_second"] == pytest.approx(ticks / 2.0)
    assert [case["wall_s"] for case in found["cases"]] == [1.0, 1.0]


def test_the_table_of_a_suite_has_a_line_a_log_by_name_with_its_time_and_what_was_found(
    tmp_path, monkeypatch
):
    tables: list[Any] = []
    monkeypatch.setattr(replay_suite, "print_table", tables.append)
    good = Case(str(tmp_path / "c.mcap"), "pass", "5 ticks, 0 differences", {}, 1.25)
    cut = good._replace(log=str(tmp_path / "a.mcap"), verdict="fail", text="cut at 7 bytes", wall_s=0.0)
    plant = good._replace(log=str(tmp_path / "b" / "b.mcap"), verdict="skipped", text="no run", wall_s=70.04)
    replay_suite.show(tmp_path, [good, cut, plant])
    (table,) = tables
    assert [str(each.header) for each in table.columns] == ["log", "verdict", "s", "found"]
    assert table.columns[2].justify == "right"
    rows = list(zip(*(each.cells for each in table.columns), strict=True))
    assert [tuple(map(str, row)) for row in rows] == [
        ("a.mcap", "FAIL", "0.0", "cut at 7 bytes"),
        ("b/b.mcap", "skipped", "70.0", "no run"),
        ("c.mcap", "pass", "1.2", "5 ticks, 0 differences"),
    ]
    assert [{str(cell.style) for cell in row} for row in rows] == [{"red"}, {"yellow"}, {""}]


def test_the_table_of_a_suite_stands_at_the_margin_of_standard_output(tmp_path, capsys):
    replay_suite.show(tmp_path, [Case(str(tmp_path / "a.mcap"), "pass", "5 ticks", {}, 1.25)])
    titles, case = capsys.readouterr().out.splitlines()
    assert titles.startswith("log ")
    assert case.startswith("a.mcap ")
    assert case.split() == ["a.mcap", "pass", "1.2", "5", "ticks"]


@pytest.mark.parametrize(("wall_s", "speed"), [(0.5, 24.0), (1.0, 12.0), (4.0, 3.0), (0.0, 0.0)])
def test_the_speed_of_a_suite_is_that_of_all_its_ticks_however_short_it_was(tmp_path, wall_s, speed):
    good = Case(str(tmp_path / "a.mcap"), "pass", "", {"ticks": 7}, 0.1)
    bad = good._replace(verdict="fail", summary={"ticks": 5})
    skipped = good._replace(verdict="skipped", summary={})
    found = summary(tmp_path, [good, bad, skipped], wall_s)
    assert (found["ticks"], found["ticks_per_second"]) == (12, speed)


def test_a_case_of_junit_says_what_was_found_where_it_first_differs_and_that_it_was_skipped(tmp_path):
    good = Case(str(tmp_path / "a.mcap"), "pass", "5 ticks", {"first": []}, 0.5)
    bad = good._replace(
        log=str(tmp_path / "b" / "b.mcap"), verdict="fail", text="cut", summary={"first": ["q", "tau"]}
    )
    plant = good._replace(log=str(tmp_path / "c.mcap"), verdict="skipped", text="no run", summary={})
    assert [tuple(each) for each in verdicts(tmp_path, [plant, bad, good])] == [
        (".", "a.mcap", None, "", "5 ticks", 0.5),
        ("b", "b.mcap", "cut", "q\ntau", "cut", 0.5),
        (".", "c.mcap", None, "", "skipped: no run", 0.5),
    ]


@pytest.mark.parametrize(
    ("verdicts_found", "success"),
    [
        (["fail"], False),
        (["fail", "fail"], False),
        (["fail", "skipped"], False),
        (["pass", "skipped"], True),
        (["pass", "fail"], False),
        (["pass"], True),
    ],
)
def test_a_suite_succeeds_where_a_log_passed_and_none_failed_and_has_its_cases_where_none_passed(
    tmp_path, verdicts_found, success
):
    cases: list[Any] = [
        Case(str(tmp_path / f"{n}.mcap"), verdict, "", {}, 0.1) for n, verdict in enumerate(verdicts_found)
    ]
    found = summary(tmp_path, cases, 1.0)
    assert found["success"] is success
    assert [case["verdict"] for case in found["cases"]] == verdicts_found
    with pytest.raises(LogError, match="but 2 of other kinds: nothing to replay"):
        summary(tmp_path, [cases[0]._replace(verdict="skipped")] * 2, 1.0)
