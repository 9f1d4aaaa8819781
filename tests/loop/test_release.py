"""A held platform and its operator: Ctrl-C does not release it; release and emergency stop do."""

from __future__ import annotations

import contextlib
import socket
import tempfile
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.signals import Mode
from hil.loop.console import Console
from hil.loop.cycle import Cycle
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from hil.operate.channel import AT_MOST, Heard, OperatorChannel
from hil.operate.client import OperatorClient
from hil.signals import Operator
from plant_fmu.faults.kinds import BrakeStuckOpen
from tests.loop.wire import daemon


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, str]]:
    with tempfile.TemporaryDirectory() as folder:  # a socket's path is short
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        yield "localcan", "held"


def asked(panel: OperatorPanel, signals: int, *, held: bool) -> tuple[Operator, ...]:
    for _ in range(signals):
        panel.interrupt(2, None)
    return panel.take(held=held)


def test_second_ctrl_c_is_an_emergency_stop_except_while_the_platform_is_held():
    panel = OperatorPanel()
    panel.running()
    assert asked(panel, 1, held=False) == (Operator.STOP,)
    assert asked(panel, 2, held=True) == (Operator.STOP, Operator.STOP)
    assert asked(panel, 1, held=False) == (Operator.ESTOP,)
    fresh = OperatorPanel()
    fresh.running()
    assert asked(fresh, 2, held=False) == (Operator.STOP, Operator.ESTOP)


class Held:
    """A console with a platform that is held or not, and a recorder that discards all events."""

    def __init__(self, channel: OperatorChannel) -> None:
        self.cycle: Any = SimpleNamespace(
            mode=Mode.PARKING,
            parts=SimpleNamespace(rate_Hz=1000.0, steering=None),
            operating=SimpleNamespace(answers=[]),
        )
        course: Any = SimpleNamespace(cycle=self.cycle, goes_on=False, waits_for_consent=False)
        self.console = Console(course, OperatorPanel(), channel)
        self.recording: Any = SimpleNamespace(event=lambda *_: None)

    def tick(self, mode: Mode) -> bool:
        self.cycle.mode = mode
        heard = self.console.take()
        self.console.answer(self.recording, 0)
        return Operator.RELEASE in heard.operator


def test_release_command_sent_before_the_platform_was_held_is_refused(bus):
    with OperatorChannel(*bus) as channel, OperatorClient(*bus) as client:
        held = Held(channel)
        client._socket.send(b"release")
        assert not held.tick(Mode.PARKING)
        assert client._socket.recv(100).startswith(b"refused: nothing is held")
        client._socket.send(b"release")
        assert not held.tick(Mode.HELD), "the release came before the platform was held"
        assert not held.tick(Mode.HELD)
        client._socket.send(b"release")
        assert held.tick(Mode.HELD)
        assert client._socket.recv(100).startswith(b"refused: nothing is held")
        assert client._socket.recv(100) == b"taken"


def test_flood_of_early_release_commands_does_not_release_a_held_platform(bus):
    """A tick reads few lines, also the first one in HELD: earlier lines remain for the next."""
    with OperatorChannel(*bus) as channel, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as flood:
        held = Held(channel)
        flood.setblocking(False)
        flood.connect(str(channel.path))
        with contextlib.suppress(BlockingIOError):
            for _ in range(3 * AT_MOST):
                flood.send(b"release")
        assert not any(held.tick(Mode.HELD) for _ in range(11))
        flood.send(b"release")
        assert held.tick(Mode.HELD)


@pytest.mark.parametrize("known", [True, False], ids=["known", "still to be let in"])
@pytest.mark.parametrize("stays", [True, False])
def test_release_sent_before_and_read_after_the_hold_began_is_refused_for_any_sender(bus, known, stays):
    """Other clients send in between, and the sender may be new, or may have disconnected."""
    with OperatorChannel(*bus) as channel, contextlib.ExitStack() as opened:
        held = Held(channel)

        def sender() -> socket.socket:
            new = opened.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
            new.connect(str(channel.path))
            return new

        talking = [sender() for _ in range(AT_MOST)]
        late = sender() if known else None
        for _ in range(3):
            held.tick(Mode.PARKING)
        for each in talking * 3:
            each.send(b"nonsense")
        late = late or sender()
        for _ in range(3):
            late.send(b"release")
        if not stays:
            late.close()
        assert not any(held.tick(Mode.HELD) for _ in range(10))
        new = sender()
        new.send(b"release")
        assert [held.tick(Mode.HELD) for _ in range(2)].count(True) == 1


def test_real_time_loop_holds_the_platform_despite_ctrl_c_and_ends_after_release():
    """The ideal configuration, in the daemon itself, with a brake that does not close when it parks."""
    panel, held, leaving = OperatorPanel(), [0], iter(range(2000))
    said: list[str] = []
    forces: list[float] = []

    def tick(row: Any, *_: Any, **__: Any) -> None:
        if row["mode"] == Mode.HELD:
            held[0] += 1
            forces.append(abs(row["tau"]).max())
            if held[0] in {100, 200, 300}:
                panel.interrupt(2, None)

    def take(*, mark_old: bool) -> Heard:
        del mark_old
        return Heard((Operator.RELEASE,) if held[0] >= 3000 else ())

    def course(cycle: Cycle) -> Any:
        found: Any = Course(cycle, 1.2, stays=True)

        def ending(tick_number: int, judged: Any = found.ending) -> Any:
            if (
                cycle.mode is Mode.FAULT and next(leaving) == 1000
            ):  # nothing brakes the leg: it swings for ever
                panel.interrupts += 2
            return judged(tick_number)

        found.ending = ending
        return found

    channel = SimpleNamespace(take=take, waited_for=False, old=frozenset())
    stuck = BrakeStuckOpen(leg=1, at_s=0.5)
    ended, _ = daemon(stuck, course=course, tick=tick, panel=panel, channel=channel, say=said.append)
    assert held[0] == 3000
    assert min(forces[10:]) > 1000.0
    assert "leg 1 moved" in said[0]
    assert "--release" in said[0]
    assert any("still moves" in text for text in said)
    assert (ended.mode, ended.released, ended.success) == (Mode.FAULT, True, False)
    assert "leg 1" in ended.reason
