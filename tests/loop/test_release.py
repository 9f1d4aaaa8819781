"""A held platform and its operator: what Ctrl-C does not do, and what lets go."""

from __future__ import annotations

import contextlib
import socket
import tempfile
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import RunError
from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.loop.daemon import OperatorPanel, Shell, run
from hil.loop.operator_socket import AT_MOST
from hil.loop.release import WORD, ReleaseSocket, send_release
from hil.loop.run_end import Course
from hil.signals import Operator
from plant_fmu.faults.brake import BrakeStuckOpen
from plant_fmu.faults.plan import FaultPlan
from tests.loop.test_run_end import Wire


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, str]]:
    with tempfile.TemporaryDirectory() as folder:  # a socket's path is short
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield "localcan", "held"


def asked(panel: OperatorPanel, signals: int, *, held: bool) -> tuple[Operator, ...]:
    for _ in range(signals):
        panel.interrupt(2, None)
    return panel.take(held=held)


def test_every_further_signal_is_an_emergency_stop_but_not_while_only_force_holds_the_platform():
    panel = OperatorPanel()
    panel.running()
    assert asked(panel, 1, held=False) == (Operator.STOP,)
    assert asked(panel, 2, held=True) == (Operator.STOP, Operator.STOP)
    assert asked(panel, 1, held=False) == (Operator.ESTOP,)
    fresh = OperatorPanel()
    fresh.running()
    assert asked(fresh, 2, held=False) == (Operator.STOP, Operator.ESTOP)


def send(bus: tuple[str, str], answers: list[str]) -> threading.Thread:
    def work() -> None:
        try:
            send_release(*bus)
            answers.append("released")
        except RunError as error:
            answers.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def test_a_word_from_before_the_platform_was_held_releases_nothing(bus):
    answers: list[str] = []
    with ReleaseSocket(*bus) as listening:
        sender = send(bus, answers)
        sender.join()  # no answer within a second: nothing is held
        assert not listening.take()
        assert not listening.take()
        sender = send(bus, answers)
        while not listening.take():
            assert sender.is_alive() or len(answers) == 2
        sender.join()
    assert "nothing was released" in answers[0]
    assert answers[1] == "released"
    assert not listening.path.exists()


def test_no_flood_of_words_from_before_releases_a_platform_that_is_held_now(bus):
    """Datagrams read in one tick are few: those of before must not be left for the next."""
    with ReleaseSocket(*bus) as listening, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as flood:
        flood.setblocking(False)
        flood.connect(str(listening.path))
        with contextlib.suppress(BlockingIOError):
            for _ in range(3 * AT_MOST):
                flood.send(WORD)
        assert not any(listening.take() for _ in range(10))
        flood.send(WORD)
        assert listening.take()


def test_where_no_controller_runs_there_is_nothing_to_release(bus):
    with pytest.raises(RunError, match="no controller runs on bus localcan:held"):
        send_release(*bus)


def test_the_daemon_holds_through_every_ctrl_c_and_ends_after_release():
    """Theory's layout, in the daemon itself; a brake that does not close when it parks."""
    c = load("ideal")
    cycle = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(c, FaultPlan([BrakeStuckOpen(leg=1, at_s=0.5)]))
    wire: Any = Wire(nodes, round(1e9 / c.loop.rate_Hz))
    panel, held = OperatorPanel(), [0]
    said: list[str] = []
    forces: list[float] = []

    def tick(row, *_, **__):
        if row["mode"] == Mode.HELD:
            held[0] += 1
            forces.append(abs(row["tau"]).max())
            if held[0] in {100, 200, 300}:
                panel.interrupt(2, None)

    recording: Any = SimpleNamespace(alive=True, dropped=0, tick=tick, event=lambda *_: None)
    release: Any = SimpleNamespace(take=lambda: held[0] >= 3000)
    shell = Shell(wire, wire, recording, panel, 0, None, release, None, said.append)
    course = Course(cycle, 1.2, stays=True)
    leaving = iter(range(2000))

    def ending(tick_number, judged=course.ending):
        if cycle.mode is Mode.FAULT and next(leaving) == 1000:  # nothing brakes the leg: it swings for ever
            panel.interrupts += 2
        return judged(tick_number)

    course.ending = ending  # type: ignore[method-assign]
    ended = run(course, shell)
    plant.close()
    assert held[0] == 3000
    assert min(forces[10:]) > 1000.0
    assert "leg 1 moved" in said[0]
    assert "--release" in said[0]
    assert any("still moves" in text for text in said)
    assert (ended.mode, ended.released, ended.success) == (Mode.FAULT, True, False)
    assert "leg 1" in ended.reason
