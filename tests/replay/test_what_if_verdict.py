"""When a what-if is a success, and which files it says are others: without a run, from made-up answers."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import LogError
from hil.app.compose import CONTROLLER_FILE, FEEDFORWARD_CSV, REFERENCE_CSV
from hil.app.configuration.configuration import load
from hil.loop.what_if import Answer
from hil.record import LogSummary
from hil.study.what_if import command
from hil.study.what_if.picture import Forces

FULL = "disk_full: No space left on device"


@pytest.fixture
def verdict(tmp_path, monkeypatch):
    """A function that sums up a what-if: its answer, and what became of its own log."""
    virtual = load("virtual")
    run = {"rate_Hz": virtual.loop.rate_Hz, "watchdog_s": 1e-3 * virtual.drives.watchdog_ms}
    log = SimpleNamespace(
        path=tmp_path / "run.mcap", attachments={}, metadata={"summary": {"closed": "clean"}}, cut=""
    )

    def summed(answer, error="", out=tmp_path / "answer.mcap", words=(), **given):
        closed = LogSummary(
            tmp_path / "answer.mcap", 5, 0, 0, 0, 0, 0.0, not error, error, gave_up=bool(error)
        )
        recording = SimpleNamespace(close=lambda _: closed)
        monkeypatch.setattr(command, "open_replayable", lambda _: (log, run, virtual))
        monkeypatch.setattr(command, "record", lambda *_: contextlib.nullcontext(recording))
        monkeypatch.setattr(command, "_answer", lambda *_: answer)
        return command.what_if_log(log.path, None, words, out=out, **given)

    return summed


def test_a_what_if_whose_own_log_is_not_whole_is_no_success(verdict):
    whole = verdict(Answer(ticks=5))
    assert (whole["success"], whole["trouble"]) == (True, None)
    full = verdict(Answer(ticks=5), FULL)
    assert (full["success"], full["trouble"]) == (False, FULL)


def test_a_what_if_that_stops_on_its_way_is_no_success_however_whole_its_own_log_is(verdict):
    found = verdict(Answer(ticks=5, gaps=[(3, 2)]), FULL)
    assert not found["success"]
    assert found["trouble"] == f"2 ticks missing from tick 3: nothing after is answered; {FULL}"
    assert not verdict(Answer(ticks=5, damage="damaged at byte 4711"))["success"]


@pytest.mark.parametrize(
    ("name", "key"),
    [
        (REFERENCE_CSV, "reference.path"),
        (CONTROLLER_FILE, "controller.controller_file"),
        (FEEDFORWARD_CSV, "feedforward.file"),
    ],
)
def test_each_file_of_another_content_than_the_logs_is_named_by_its_key(monkeypatch, name, key):
    log: Any = SimpleNamespace(path=Path("run.mcap"), attachments={name: b"before"})
    here = load("virtual")

    def others(files):
        monkeypatch.setattr(command, "attachments", lambda _: list(files.items()))
        return command._other_files(here, log)

    assert others({name: b"after"}) == [f"{key}: the file has another content than that of the log"]
    assert others({name: b"before"}) == others({}) == []


def test_a_what_if_is_as_fast_as_the_logged_time_over_its_own(verdict, monkeypatch):
    clock = SimpleNamespace(perf_counter=iter((1000.0, 1000.25)).__next__)
    monkeypatch.setattr(command, "time", clock)
    found = verdict(Answer(ticks=500))
    assert (found["wall_s"], found["logged_s"]) == (0.25, 0.5)
    assert found["times_real_time"] == pytest.approx(2.0)
    monkeypatch.setattr(command, "time", SimpleNamespace(perf_counter=lambda: 7.0))
    assert verdict(Answer(ticks=500))["times_real_time"] == 0.0, "a clock that stood still"


def test_an_interrupt_is_handed_on_and_names_the_log_that_was_begun(monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt("by the operator")

    monkeypatch.setattr(command, "what_if", interrupted)
    nothing: Any = None
    with pytest.raises(KeyboardInterrupt, match=r"^by the operator$"):
        command._answer(nothing, nothing, None, None, None)
    closed: list[Any] = []
    recording: Any = SimpleNamespace(path=tmp_path / "a.mcap", close=closed.append)
    with pytest.raises(KeyboardInterrupt, match=r"what it answered until then: \S+/a\.mcap$"):
        command._answer(nothing, nothing, recording, None, None)
    assert closed == [{"reason": "interrupted"}]


def test_an_answer_without_a_tick_says_so_where_nothing_else_says_why(verdict):
    found = verdict(Answer())
    assert (found["success"], found["trouble"], found["times_real_time"]) == (
        False,
        "the log has no tick",
        0.0,
    )
    assert verdict(Answer(damage="damaged at byte 47\x07"))["trouble"] == "damaged at byte 47\\x07"
    assert verdict(Answer(), FULL)["trouble"] == f"the log has no tick; {FULL}"


def test_the_log_that_was_written_is_named_and_none_where_none_was(verdict, tmp_path):
    written = verdict(Answer(ticks=5))
    assert written["answer_log"] == str(tmp_path / "answer.mcap")
    without = verdict(Answer(ticks=5), out=None)
    assert (without["answer_log"], without["success"], without["trouble"]) == (None, True, None)
    for found in (written, without):
        assert (found["log"], found["configuration"]) == (str(tmp_path / "run.mcap"), load("virtual").source)
        assert (found["changed"], found["picture"]) == ([], None)


@pytest.mark.parametrize("ticks", [0, 5])
def test_the_picture_names_the_log_and_the_controller_and_is_drawn_of_an_answer_with_ticks_alone(
    verdict, tmp_path, monkeypatch, ticks
):
    drawn: list[Any] = []
    monkeypatch.setattr(Forces, "draw", lambda _, *given: drawn.append(given))
    picture, words = tmp_path / "a.png", ["limits.force_N=1"]
    found = verdict(Answer(ticks=ticks), picture=picture, words=words)
    title = "run.mcap: recorded, and what virtual limits.force_N=1 would have sent"
    assert found["changed"] == [f"limits.force_N: {load('virtual').limits.force_N} -> 1.0"]
    assert (found["picture"], drawn) == ((str(picture), [(picture, title)]) if ticks else (None, []))


def test_a_picture_that_cannot_be_written_in_the_end_is_no_success_and_keeps_the_figures(
    verdict, tmp_path, monkeypatch
):
    def full(*_):
        raise LogError("--plot a.png: No space left on device")

    monkeypatch.setattr(Forces, "draw", full)
    found = verdict(Answer(ticks=5), picture=tmp_path / "a.png")
    assert (found["success"], found["ticks"], found["picture"]) == (False, 5, None)
    assert found["unwritten"] == ["--plot a.png: No space left on device"]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"picture": "notes.txt"}, "--plot .*notes.txt: allowed are the endings"),
        ({"out": "there.mcap"}, "there.mcap: exists and is not overwritten"),
    ],
)
def test_an_output_that_cannot_be_written_is_refused_before_the_log_is_opened(
    tmp_path, monkeypatch, given, message
):
    (tmp_path / "there.mcap").touch()
    monkeypatch.setattr(command, "open_replayable", lambda _: pytest.fail("the log was opened"))
    with pytest.raises(LogError, match=message):
        command.what_if_log(tmp_path / "run.mcap", **{key: tmp_path / name for key, name in given.items()})


def test_what_is_asked_for_is_collected_and_nothing_else(verdict, tmp_path, monkeypatch):
    asked: list[Any] = []

    def answered(*given):
        asked.append(given[2:])
        return Answer()

    verdict(Answer())  # from here on its log is there
    monkeypatch.setattr(command, "_answer", answered)
    command.what_if_log(tmp_path / "run.mcap", progress=print)
    command.what_if_log(tmp_path / "run.mcap", picture=tmp_path / "a.svg", out=tmp_path / "b.mcap")
    (without, progress), (kept, none) = ((each[:2], each[2]) for each in asked)
    assert (without, progress, none) == ((None, None), print, None)
    assert kept[0] is not None
    assert isinstance(kept[1], Forces)


@pytest.mark.parametrize("named", [None, "another"])
def test_changes_are_to_the_logs_own_configuration_where_none_is_named_and_both_are_held_together(
    verdict, tmp_path, monkeypatch, named
):
    virtual, other = load("virtual"), load("virtual").model_copy(update={"name": "other"})
    asked: list[Any] = []
    verdict(Answer())  # from here on its log is there

    def changed(c, words, *, own):
        asked.append((c.name, words, own))
        return other

    monkeypatch.setattr(command, "load", lambda name: other.model_copy(update={"name": name}))
    monkeypatch.setattr(command, "changed", changed)
    monkeypatch.setattr(command, "refuse_other_inputs", lambda *given: asked.append(given))
    command.what_if_log(tmp_path / "run.mcap", named, ("limits.force_N=1",))
    (name, words, own), (there, here, rate_Hz) = asked
    assert (name, words, own) == (named or "virtual", ("limits.force_N=1",), named is None)
    assert (there.name, here.name, rate_Hz) == ("virtual", "other", virtual.loop.rate_Hz)


@pytest.mark.parametrize("named", [None, "another"])
def test_the_answer_comes_of_the_asked_controller_with_the_files_of_the_log_where_it_is_the_logs_own(
    verdict, tmp_path, monkeypatch, named
):
    other, cycle, asked = load("virtual").model_copy(update={"name": "other"}), object(), list[Any]()
    verdict(Answer(), out=None)  # from here on its log is there

    def with_files(own, here, log, folder):
        asked.append((own.name, here.name, log.path.name, folder is not None and folder.is_dir()))
        return "with files"

    def begun(log, run, own, given):
        asked.append((log.path.name, sorted(run), own.name, given))
        return cycle

    def record(here, given, path, log):
        asked.append((here.name, given is cycle, path.name, log.path.name))
        return contextlib.nullcontext(
            SimpleNamespace(close=lambda _: SimpleNamespace(complete=True, error=""))
        )

    monkeypatch.setattr(command, "load", lambda _: other)
    monkeypatch.setattr(command, "changed", lambda *_, **__: other)
    monkeypatch.setattr(command, "_with_files", with_files)
    monkeypatch.setattr(command, "_cycle", begun)
    monkeypatch.setattr(command, "_other_files", lambda given, log: [given, log.path.name])

    def answer(log, given, *_):
        asked.append((log.path.name, given is cycle))
        return Answer()

    monkeypatch.setattr(command, "record", record)
    monkeypatch.setattr(command, "_answer", answer)
    monkeypatch.setattr(command, "_remarks", lambda log, here, answer, given: [here.name, given is cycle])
    found = command.what_if_log(tmp_path / "run.mcap", named, out=tmp_path / "a.mcap")
    assert asked == [
        ("virtual", "other", "run.mcap", named is None),
        ("run.mcap", ["rate_Hz", "watchdog_s"], "virtual", "with files"),
        ("other", True, "a.mcap", "run.mcap"),
        ("run.mcap", True),
    ]
    assert (found["changed"], found["remarks"]) == (["with files", "run.mcap"], ["other", True])
