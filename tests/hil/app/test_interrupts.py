"""Ctrl-C in this process: one line, exit code 130, closed logs."""

from __future__ import annotations

import os
import signal
import threading
import time
from types import SimpleNamespace

import pytest

from hil.app import replay
from hil.app.configuration.configuration import load
from hil.app.output import leaving
from hil.app.sim import command
from hil.cli import check, main
from hil.cli.interrupts import INTERRUPTED
from hil.loop.panel import OperatorPanel
from hil.record import Recording, child
from hil.record.child import RecorderEnd
from hil.record.log import Log


def press(number=signal.SIGINT):
    """Send a signal to this thread, the only one of a command; the test runner has another one."""
    signal.pthread_kill(threading.get_ident(), number)


@pytest.fixture(autouse=True)
def foreground():
    """Handle SIGINT as in a terminal; in the background of a shell it is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def process(monkeypatch, capsys):
    """Run a command in this process; return its exit code and its standard error."""

    def run(*words):
        monkeypatch.setattr("sys.argv", ["hil", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().err

    return run


def interrupted_in(monkeypatch, work):
    """Replace the work of `hil check`."""
    monkeypatch.setattr(check, "load", lambda *_: work())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_prints_one_line_and_exits_with_130(process, monkeypatch, number):
    interrupted_in(monkeypatch, lambda: press(number))
    assert process("check") == (INTERRUPTED, "hil: interrupted\n") == (130, "hil: interrupted\n")
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_interrupt_that_a_library_converts_to_an_error_is_reported_as_interrupt(process, monkeypatch):
    def work():
        try:
            press()
        except KeyboardInterrupt as interrupt:
            raise OSError("aborted") from interrupt

    interrupted_in(monkeypatch, work)
    assert process("check") == (INTERRUPTED, "hil: interrupted\n")


def test_interrupt_of_hil_new_reports_the_unanswered_question(process, monkeypatch, tmp_path):
    """The end of the input at the same place is a missing answer, with exit code 2."""

    def ended(_: str) -> str:
        raise EOFError

    for work, told, code in (
        (lambda _: press(), "interrupted at base_radius_m, nothing is written", 130),
        (ended, "hil new: ended at base_radius_m, nothing is written", 2),
    ):
        monkeypatch.setattr("click.termui.visible_prompt_func", work)
        given, said = process("new", tmp_path / "r.yaml")
        assert (given, said.count("\n")) == (code, 1)
        assert said.startswith(f"hil: {told}")
        assert "(--base-radius for this one)" in said
    assert not list(tmp_path.iterdir())


def test_second_interrupt_does_not_disturb_the_closing_of_files(process, monkeypatch):
    closed = []

    def work():
        try:
            press()
        finally:
            press()
            closed.append(True)

    interrupted_in(monkeypatch, work)
    assert process("check") == (130, "hil: interrupted\n")
    assert closed


def test_interrupt_during_the_recorder_start_takes_effect_after_the_start(monkeypatch):
    order: list[str] = []

    def start(*_: object, **__: object) -> None:
        press()
        order.append("started")

    signal.signal(signal.SIGINT, lambda *_: order.append("interrupted"))
    monkeypatch.setattr(child, "start", start)
    RecorderEnd(SimpleNamespace(fd=3))  # type: ignore[arg-type]
    assert order[:2] == ["started", "interrupted"]


def test_interrupted_simulation_reports_its_log_which_is_complete(process, monkeypatch, tmp_path):
    path = tmp_path / "a.mcap"
    record, ticks = Recording.ticks_of_items, [0]

    def several(self, rows, *given):
        record(self, rows, *given)
        ticks[:] = [int(rows["tick"][-1]) + 1]
        if ticks[0] >= 150:
            press()

    monkeypatch.setattr(Recording, "ticks_of_items", several)
    code, said = process("sim", "--duration", "0.3", "--log", path)
    assert code == 130
    last_s = 1e-3 * (ticks[0] - 1)
    assert said == f"hil: interrupted at {last_s:.3f} s of simulated time; the log until then: {path}\n"
    log = Log.open(path)
    assert len(log.rows()) == ticks[0]
    assert log.metadata["summary"]["reason"] == "interrupted"


def test_interrupt_while_the_recorder_writes_leaves_a_complete_log(process, monkeypatch, tmp_path):
    path = tmp_path / "a.mcap"
    send, answer, answered = RecorderEnd.send, RecorderEnd.answer, []

    def send_to_a_busy_one(recorder, data):
        os.kill(recorder.process.pid, signal.SIGSTOP)
        send(recorder, data)

    def interrupted_answer(recorder, timeout_s):
        answered.append(timeout_s)
        if len(answered) == 2:  # the first one was at the start
            press()
        os.kill(recorder.process.pid, signal.SIGCONT)
        return answer(recorder, timeout_s)

    monkeypatch.setattr(RecorderEnd, "send", send_to_a_busy_one)
    monkeypatch.setattr(RecorderEnd, "answer", interrupted_answer)
    code, said = process("sim", "ideal", "--duration", "0.1", "--log", path)
    assert len(answered) == 3
    assert (code, said) == (130, f"hil: interrupted after the run, which ended in PARKED; its log: {path}\n")
    log = Log.open(path)
    assert (log.cut, log.metadata["summary"]["ending"]) == ("", "PARKED")


def test_interrupt_of_the_replay_reports_the_end_of_the_simulation(monkeypatch, tmp_path):
    monkeypatch.setattr(replay, "replay_log", lambda _: press())
    with pytest.raises(
        KeyboardInterrupt, match=r"after the run, which ended in PARKED; its log is whole: .*a\.mcap"
    ):
        command.simulate(load("virtual"), log=tmp_path / "a.mcap", duration_s=0.1)
    assert not Log.open(tmp_path / "a.mcap").cut


def test_second_interrupt_during_the_start_of_a_run_does_not_disturb_the_cleanup():
    panel = OperatorPanel()

    def begin():
        try:
            press()
        finally:
            press()

    with panel.attached(), pytest.raises(KeyboardInterrupt):
        begin()
    assert panel.interrupts == 2


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_closed_terminal_ends_a_bring_up_like_ctrl_c(process, number, monkeypatch):
    """On the way out its steps switch off all that they switched on."""
    let_go = []

    def steps(*_, **__):
        try:
            os.kill(os.getpid(), number)
            time.sleep(5.0)
        finally:
            let_go.append(number)

    before = signal.getsignal(number)
    monkeypatch.setattr("hil.lab.bringup.command.run_bringup", steps)
    assert process("bringup", "virtual", "--rehearse", "--yes") == (INTERRUPTED, "hil: interrupted\n")
    assert let_go == [number]
    assert signal.getsignal(number) is before


@pytest.mark.parametrize(("own", "told"), [("", "a log"), ("at 2 s", "at 2 s")])
def test_interrupt_message_has_the_text_of_its_exception_or_else_lists_the_written_outputs(own, told):
    with pytest.raises(KeyboardInterrupt) as interrupt, leaving(lambda: "nothing has moved"):  # noqa: SIM117
        with leaving(lambda: "a log"):
            raise KeyboardInterrupt(*([own] if own else []))
    assert str(interrupt.value) == told
