"""What `hil replay` asks of each of its forms, and what of the answer it prints, without a log to read."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from hil.app import output
from hil.app.replay import summary
from hil.cli import main
from hil.cli.replay_forms import chosen_form
from hil.loop.replay import Comparison, Difference
from hil.study.replay_suite import Case
from tests.replay.test_against_shown import BOTH
from tests.replay.test_what_if_shown import result


@pytest.fixture
def replayed(tmp_path):
    """A function that runs `hil replay` on `run.mcap`, with `other.mcap` beside it; both are empty."""
    for name in ("run.mcap", "other.mcap"):
        (tmp_path / name).touch()

    def run(*words):
        return CliRunner().invoke(main, ["replay", *map(str, words)])

    return run


@pytest.mark.parametrize(
    ("words", "tolerances", "align"),
    [
        ([], (), "tick"),
        (["--align", "tick"], (), "tick"),
        (["--align", "motion", "--tolerance", "1e-9", "--tolerance", "tau=2"], ("1e-9", "tau=2"), "motion"),
    ],
)
def test_a_comparison_is_of_the_log_with_the_other_one_and_its_table_stands_above_its_figures(
    replayed, tmp_path, monkeypatch, words, tolerances, align
):
    asked: list[Any] = []

    def against(*given, align):
        asked.append((*given, align))
        return BOTH

    monkeypatch.setattr("hil.study.against.command.against", against)
    log, other, twin = (tmp_path / name for name in ("run.mcap", "other.mcap", "a.json"))
    found = replayed(log, "--against", other, *words, "--json", twin)
    assert asked == [(log, other, tolerances, align)]
    assert found.exit_code == 1, "it is no success"
    assert json.loads(twin.read_text()) == BOTH
    lines = [" ".join(line.split()) for line in found.stdout.splitlines()]
    assert [line.partition(" ")[0] for line in lines[:5]] == [
        "column",
        "q",
        "tau.leg_2",
        "mode",
        "compute_ns",
    ]
    assert lines[5] == "compared: failed"
    assert "ticks compared 800" in lines[6:]


def test_a_what_if_is_asked_with_all_that_was_given_and_its_tables_stand_above_its_figures(
    replayed, tmp_path, monkeypatch
):
    asked: list[Any] = []

    def what_if_log(*given, **options):
        asked.append((given, options))
        return result(different_ticks=1)

    monkeypatch.setattr("hil.study.what_if.command.what_if_log", what_if_log)
    monkeypatch.setattr("hil.record.log.Log.open", lambda _: None)
    log, picture, out = (tmp_path / name for name in ("run.mcap", "a.png", "a.mcap"))
    words = ("limits.force_N=1", "name=x")
    pairs = [("--what-if", "lab"), *(("--set", each) for each in words), ("--plot", picture), ("--log", out)]
    found = replayed(log, *(word for pair in pairs for word in pair))
    assert found.exit_code == 0, found.output
    assert asked == [((log, "lab", words), {"picture": picture, "out": out, "progress": None})]
    lines = found.stdout.splitlines()
    assert lines[0] == "force, what-if less recorded, over 0 of 6 ticks:"
    assert "what-if: success" in lines[8:]


def test_each_column_of_the_first_tick_that_differs_is_a_line_of_standard_error_and_the_story_follows(
    replayed, tmp_path, monkeypatch
):
    first = [Difference(7, "mode", 1, 2), Difference(7, "bell\x07", "a", "b")]
    story: Any = SimpleNamespace(fields=lambda: {"lines": ["BUS at tick 5", "  leg 3"]})
    differs = Comparison(ticks=9, different_ticks=1, first=first, story=story)
    fields = summary(differs, 1.0, 2.0) | {"agrees": False, "remark": "the log was cut"}
    monkeypatch.setattr("hil.app.replay.replay_log", lambda *_: (differs, fields))
    monkeypatch.setattr("hil.record.log.Log.open", lambda _: None)
    found = replayed(tmp_path / "run.mcap")
    assert found.exit_code == 1
    assert found.stderr.splitlines() == [
        "hil: tick 7: mode: recorded 1, replayed 2",
        "hil: tick 7: bell\\x07: recorded a, replayed b",
        "  BUS at tick 5",
        "    leg 3",
    ]
    assert "remark the log was cut" in [" ".join(line.split()) for line in found.stdout.splitlines()]


@pytest.mark.parametrize(("agrees", "code"), [(True, 0), (False, 1)])
def test_a_replay_is_a_success_where_it_agrees_as_on_another_cpu_that_rounds_otherwise(
    replayed, tmp_path, monkeypatch, agrees, code
):
    rounded = Comparison(ticks=9, different_ticks=1, first=[Difference(7, "tau[0]", 1.0, 1.0 + 1e-15)])
    fields = summary(rounded, 1.0, 2.0) | {"agrees": agrees, "exact": False}
    monkeypatch.setattr("hil.app.replay.replay_log", lambda *_: (rounded, fields))
    monkeypatch.setattr("hil.record.log.Log.open", lambda _: None)
    found = replayed(tmp_path / "run.mcap")
    assert (found.exit_code, "replay: success" in found.stdout) == (code, agrees)


def test_a_junit_file_that_could_not_be_written_is_refused_before_a_log_is_replayed(
    replayed, tmp_path, monkeypatch
):
    notes = tmp_path / "notes.xml"
    notes.write_text("mine")
    monkeypatch.setattr("hil.study.replay_suite.run_suite", lambda *_: pytest.fail("a log was replayed"))
    found = replayed("--suite", tmp_path, "--junit", notes)
    assert found.exit_code == 2, found.output
    assert f"--junit {notes}: exists, is not a JUnit report" in " ".join(found.stderr.split())
    assert notes.read_text() == "mine"


@pytest.mark.parametrize("terminal", [True, False])
def test_the_bar_of_a_suite_counts_its_logs_on_a_terminal_alone_and_leaves_nothing_behind(
    replayed, tmp_path, monkeypatch, terminal
):
    bars: list[Any] = []

    class Bar:
        def __init__(self, *_, console, transient, disable):
            assert console is output.console
            bars.append((transient, disable))

        def __enter__(self):
            return self

        def __exit__(self, *_):
            bars.append("closed")

        def add_task(self, text, *, total):
            bars.append(total)
            return "the task"

        def update(self, task, **counts):
            bars.append((task, counts))

    def run_suite(paths, jobs, progress):
        for done, path in enumerate(paths, 1):
            progress(done, len(paths))
            yield Case(str(path), "pass", "", {"ticks": 4}, 0.5)

    monkeypatch.setattr("rich.progress.Progress", Bar)
    monkeypatch.setattr("hil.study.replay_suite.run_suite", run_suite)
    monkeypatch.setattr(type(output.console), "is_terminal", property(lambda _: terminal))
    found = replayed("--suite", tmp_path)
    assert found.exit_code == 0, found.output
    counts = [("the task", {"completed": n, "total": 2}) for n in (1, 2)]
    assert bars == [(True, not terminal), None, *counts, "closed"]


@pytest.mark.parametrize(
    ("given", "form"),
    [
        ({}, ""),
        ({"what_if": "virtual"}, "--what-if"),
        ({"what_if": ""}, "--what-if"),
        ({"words": ("a=1",)}, "--what-if"),
        ({"words": ("",)}, "--what-if"),
        ({"against": Path("b.mcap")}, "--against"),
        ({"salvage": Path("c.mcap")}, ""),
        ({"salvage": Path("c.mcap"), "what_if": "virtual", "words": ("a=1",)}, "--what-if"),
    ],
)
def test_what_is_given_decides_what_is_asked_also_where_it_is_an_empty_word(given, form):
    nothing = dict.fromkeys(
        ("what_if", "against", "suite", "salvage", "picture", "out", "align", "jobs", "junit")
    ) | {"words": (), "tolerances": ()}
    assert chosen_form(Path("a.mcap"), nothing | given) == form
