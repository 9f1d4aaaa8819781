"""Ctrl-C in this process: one line, exit code 130, closed logs; no press disturbs what closes them."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.app.configuration.configuration import load
from hil.app.sim import command
from hil.cli import check, main
from hil.cli.interrupts import INTERRUPTED, Interrupts, comes_of_interrupt
from hil.loop.panel import OperatorPanel
from hil.record import Recording, child
from hil.record.log import Log
from hil.study import workers


def press():
    os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture(autouse=True)
def foreground():
    """Let SIGINT be as in a terminal: it is ignored in the background of a shell."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGALRM)}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def process(monkeypatch, capsys):
    """Be the process of a command: return its exit code and what it says on standard error."""

    def run(*words):
        monkeypatch.setattr("sys.argv", ["hil", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, capsys.readouterr().err

    return run


def interrupted_in(monkeypatch, work):
    """Let `hil check` do that instead."""
    monkeypatch.setattr(check, "load", lambda *_: work())


def test_an_interrupt_is_one_line_and_130(process, monkeypatch):
    interrupted_in(monkeypatch, press)
    assert process("check") == (INTERRUPTED, "hil: interrupted\n") == (130, "hil: interrupted\n")


def test_an_interrupt_of_a_question_is_one_line_that_says_which_and_130(process, monkeypatch, tmp_path):
    """The end of the input at the same place is a missing answer: 2."""

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


def test_a_second_press_does_not_disturb_what_closes_the_files(process, monkeypatch):
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


def test_what_a_library_makes_of_an_interrupt_is_one_line_too(process, monkeypatch):
    def work():
        with contextlib.suppress(KeyboardInterrupt):
            press()
        raise TypeError("error building the serializer: KeyboardInterrupt")

    interrupted_in(monkeypatch, work)
    assert process("check") == (130, "hil: interrupted\n")


@pytest.mark.parametrize("printed", [False, True])
def test_a_press_that_python_drops_is_repeated_and_not_printed(printed, process, monkeypatch):
    class Dropping:
        def __del__(self):
            try:
                press()
            except KeyboardInterrupt:
                if printed:  # as what Cython has compiled does before
                    sys.excepthook(*sys.exc_info())
                raise

    def work():
        Dropping()
        signal.sigtimedwait([], 5.0)
        raise AssertionError("the press was lost")

    interrupted_in(monkeypatch, work)
    assert process("check") == (130, "hil: interrupted\n")


def test_after_a_command_nothing_that_repeats_a_press_ends_the_interpreter(process, monkeypatch):
    interrupted_in(monkeypatch, press)
    process("check")
    assert [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGALRM)] == [signal.SIG_IGN] * 2


def test_a_press_after_the_result_changes_nothing(monkeypatch):
    interrupts = Interrupts()
    interrupts.settle()
    interrupts.pressed(signal.SIGINT, None)
    ends: list[int] = []
    monkeypatch.setattr("os._exit", ends.append)
    interrupts.pressed(signal.SIGINT, None)
    assert not ends
    interrupts.pressed(signal.SIGINT, None)
    assert ends == [130], "the third one in vain ends a process that hangs"


def test_a_press_in_the_import_of_a_library_is_repeated_behind_it(monkeypatch, tmp_path):
    """Libraries whose start is C++ end the process where Python raises in it: ruckig does."""
    (tmp_path / "a_library.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nwhole = sum(range(1000))\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    interrupts = Interrupts()
    seen = []

    def work() -> None:
        seen.append(import_module("a_library").whole)
        end = time.monotonic() + 5.0
        while time.monotonic() < end:
            pass

    with interrupts.attached(), pytest.raises(KeyboardInterrupt):
        work()
    monkeypatch.delitem(sys.modules, "a_library")
    assert seen == [499500]
    assert interrupts.raised


@pytest.mark.parametrize(
    ("library", "finishes"),
    [("llvmlite.binding.ffi", True), ("numba.core.dispatcher", True), ("scipy", False)],
)
def test_a_press_while_a_library_frees_what_it_would_free_twice_is_repeated_behind_it(
    library, finishes, process, monkeypatch
):
    steps: list[str] = []
    frees = compile("steps.append('begun'); press(); steps.append('freed')", "a library", "exec")

    def work():
        exec(frees, {"__name__": library, "steps": steps, "press": press})
        time.sleep(1.0)
        steps.append("not interrupted")

    interrupted_in(monkeypatch, work)
    assert process("check") == (INTERRUPTED, "hil: interrupted\n")
    assert steps == (["begun", "freed"] if finishes else ["begun"])


def test_an_interrupt_before_the_words_are_read_is_one_line_too(process, monkeypatch):
    monkeypatch.setattr(main, "_main_shell_completion", lambda *_: press())
    assert process("check") == (INTERRUPTED, "hil: interrupted\n")


def test_before_the_command_line_has_its_answer_to_an_interrupt_the_package_imports_next_to_nothing():
    program = "import sys; before = {*sys.modules}; import hil; print(*sorted({*sys.modules} - before))"
    done = subprocess.run(
        [sys.executable, "-S", "-c", "import importlib, __future__; " + program],
        cwd=Path(__file__).parents[3], capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split() == ["hil"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGALRM], ids=["pressed", "repeated"])
@pytest.mark.parametrize("starting", ["worker", "recorder"])
def test_a_press_while_a_process_is_started_waits_until_it_is(starting, number, monkeypatch):
    order: list[str] = []

    def start(*_: object, **__: object) -> None:
        signal.raise_signal(number)
        order.append("started")

    signal.signal(number, lambda *_: order.append("interrupted"))
    if starting == "worker":
        monkeypatch.setattr(ProcessPoolExecutor, "submit", start)
        with pytest.raises(AttributeError, match="_condition"):  # of the outcome, which it has none of
            list(workers.perform([1, 2], abs, abs, 2, None))
    else:
        monkeypatch.setattr(child, "start", start)
        child.spawn(SimpleNamespace(fd=-1))  # type: ignore[arg-type]
    assert order[:2] == ["started", "interrupted"]


def test_only_what_comes_of_an_interrupt_is_taken_for_one():
    cause = ImportError("numpy")
    cause.__cause__ = KeyboardInterrupt()
    assert comes_of_interrupt(cause)
    assert not comes_of_interrupt(ImportError("numpy"))
    assert not comes_of_interrupt(None)


def test_an_interrupted_simulation_names_its_log_which_is_whole(process, monkeypatch, tmp_path):
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


def test_an_interrupt_while_the_recorder_still_writes_leaves_a_whole_log(process, monkeypatch, tmp_path):
    path = tmp_path / "a.mcap"
    send, answer, answered = child.send, child.answer, []

    def send_to_a_busy_one(recorder, data):
        os.kill(recorder.pid, signal.SIGSTOP)
        send(recorder, data)

    def interrupted_answer(recorder, timeout_s):
        answered.append(timeout_s)
        if len(answered) == 2:  # the first one was at the start
            press()
        os.kill(recorder.pid, signal.SIGCONT)
        return answer(recorder, timeout_s)

    monkeypatch.setattr("hil.record.recording.send", send_to_a_busy_one)
    monkeypatch.setattr("hil.record.recording.answer", interrupted_answer)
    code, said = process("sim", "ideal", "--duration", "0.1", "--log", path)
    assert len(answered) == 3
    assert (code, said) == (130, f"hil: interrupted after the run, which ended in PARKED; its log: {path}\n")
    log = Log.open(path)
    assert (log.cut, log.metadata["summary"]["ending"]) == ("", "PARKED")


def test_an_interrupt_of_the_replay_after_a_simulation_says_how_it_ended(monkeypatch, tmp_path):
    monkeypatch.setattr(command, "replay_log", lambda _: press())
    with pytest.raises(
        KeyboardInterrupt, match=r"after the run, which ended in PARKED; its log is whole: .*a\.mcap"
    ):
        command.simulate(load("virtual"), log=tmp_path / "a.mcap", duration_s=0.1)
    assert not Log.open(tmp_path / "a.mcap").cut


def test_before_the_loop_a_second_press_does_not_disturb_the_end_of_the_start():
    panel = OperatorPanel()

    def begin():
        try:
            press()
        finally:
            press()

    with panel.attached(), pytest.raises(KeyboardInterrupt):
        begin()
    assert panel.interrupts == 2


def test_too_few_files_are_named_with_their_limit(process, monkeypatch):
    def work():
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    interrupted_in(monkeypatch, work)
    code, said = process("check")
    most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert code == 2
    assert said == f"hil: a process may open {most} files here, and that is too few: raise `ulimit -n`\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_terminal_that_goes_ends_a_bring_up_as_ctrl_c_does(process, number, monkeypatch):
    """What its steps switched on they switch off on the way out."""
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


PRESSES = """
import os, signal, sys

def called(frame, event, argument):
    if event == "call" and frame.f_code.co_name == "__call__" and frame.f_code.co_filename.endswith(END):
        sys.setprofile(None)
        os.kill(os.getpid(), signal.SIGINT)

END = os.path.join("hil", "cli", "__init__.py")
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.setprofile(called)
"""


@pytest.mark.parametrize(
    "words", [("-m", "hil.cli"), (str(Path(sys.executable).with_name("hil")),)], ids=["module", "script"]
)
def test_an_interrupt_between_the_imports_and_the_command_ends_it_without_a_word(words, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(PRESSES)
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[3])])
    done = subprocess.run(
        [sys.executable, *words, "--help"],
        env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


def test_another_program_that_answers_an_interrupt_itself_may_import_the_command_line_in_a_thread():
    program = (
        "import signal, threading; signal.signal(signal.SIGINT, signal.SIG_IGN); done = []\n"
        "def work():\n    import hil.cli; done.append(signal.getsignal(signal.SIGINT))\n"
        "thread = threading.Thread(target=work); thread.start(); thread.join()\n"
        "assert done == [signal.SIG_IGN], done"
    )
    subprocess.run([sys.executable, "-c", program], cwd=Path(__file__).parents[3], check=True)
