"""A family on several buses, part by part: each drive hears, answers and remembers on its own bus alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.identity import SERIAL, Identified, Said
from drivers.protocol import (
    BUS,
    FD,
    Alive,
    Answer,
    Configure,
    DeviceCommand,
    DeviceMessage,
    EmergencyStop,
    Frame,
    Received,
    Rejected,
    Status,
    Sync,
)
from drivers.several_buses import SeveralBuses
from drivers.signals import DriveMode, DriveState, Reaction

BUSES = ((0, 4), (1, 5), (2, 3))
HOME = (0, 1, 2, 2, 0, 1)
"""Bus of each leg."""


class Family:
    """Frames of the identifiers 0 to 5 are of those legs; one of 10 is for the legs that its data names."""

    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.messages: tuple[DeviceMessage, ...] = ()

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        assert frame.flags < BUS
        return tuple(frame.data) if frame.id == 10 else (frame.id,)

    def sender(self, frame: Frame) -> int:
        assert frame.flags < BUS
        return frame.id if frame.id < 6 else -1

    def emergency_stop(self) -> tuple[Frame, ...]:
        return Frame(10, bytes((5, 0)), FD), Frame(3, b"\3"), Frame(10, bytes(range(6)))

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        self.asked.append((received, tick, since_ns))
        return tick > 0

    def parse(self, memory: int, frame: Frame) -> tuple[int, tuple[DeviceMessage, ...]]:
        self.asked.append(frame)
        return memory + 1, self.messages

    def answer(self, memory: int, *given: Any) -> tuple[int, list[tuple[int, Frame]]]:
        self.asked.append(given)
        return memory + 1, [(leg, Frame(leg, bytes((memory,)))) for leg in range(6)]

    def report(self, memory: int, status: Status) -> tuple[int, tuple[Frame, ...]]:
        return memory + 1, (Frame(status.leg, bytes((memory,))), Frame(status.leg, b"", FD))

    def restarted(self, memory: int, legs: list[int]) -> tuple[int, tuple[int, ...]]:
        return memory, tuple(legs)

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        return (Frame(4, b"serial"), Frame(2, b"serial")), (Frame(1, b"version"),)

    def identity(self, frame: Frame) -> Said | None:
        assert frame.flags < BUS
        return Said(frame.id, SERIAL, 7) if frame.id < 6 else None


def several() -> tuple[Any, Any]:
    family: Any = Family()
    return SeveralBuses(family, BUSES), family


def on(bus: int, *given: Any) -> Frame:
    frame = Frame(*given)
    return frame._replace(flags=frame.flags + BUS * bus)


def test_a_frame_for_some_legs_goes_once_on_each_bus_of_theirs_in_the_order_of_the_buses():
    protocol, _ = several()
    assert protocol.emergency_stop() == (
        *(on(bus, 10, bytes((5, 0)), FD) for bus in (0, 1)),
        on(2, 3, b"\3"),
        *(on(bus, 10, bytes(range(6))) for bus in (0, 1, 2)),
    )


def test_a_frame_concerns_those_of_its_legs_that_are_on_its_bus():
    protocol, _ = several()
    found = [protocol.addressed(on(bus, 10, bytes((5, 1, 3, 0)))) for bus in range(4)]
    assert found == [(0,), (5, 1), (3,), ()]
    assert [protocol.sender(on(bus, 5, b"")) for bus in range(3)] == [-1, 5, -1]


@pytest.mark.parametrize("leg", range(6))
def test_a_feedback_is_judged_with_its_time_and_tick_where_it_is_at_home(leg):
    protocol, family = several()
    frame = Frame(leg, b"x", FD)
    fresh = [protocol.fresh(Received(40, on(bus, *frame)), 9, 30) for bus in range(3)]
    assert fresh == [bus == HOME[leg] for bus in range(3)]
    assert family.asked == [(Received(40, frame), 9, 30)]
    assert not protocol.fresh(Received(40, on(HOME[leg], *frame)), 0, 30)


def test_a_frame_is_heard_by_the_drives_of_its_bus_and_on_one_that_is_not_there_by_none():
    protocol, family = several()
    for bus in range(3):
        memory, messages = protocol.parse((10, 20, 30), on(bus, 10, b"x", FD))
        assert (memory, messages) == (tuple(10 + 10 * k + (k == bus) for k in range(3)), ())
    assert family.asked == [Frame(10, b"x", FD)] * 3
    assert protocol.parse((10, 20, 30), on(3, 10, b"x")) == ((10, 20, 30), ())
    assert len(family.asked) == 3


def command(*legs: int) -> DeviceCommand:
    return DeviceCommand(legs, DriveMode.RUN, np.zeros(len(legs)), 1)


@pytest.mark.parametrize(
    ("message", "heard"),
    [
        (Answer(5, Frame(5, b"x")), Answer(5, on(1, 5, b"x"))),
        (Answer(0, Frame(0, b"x")), None),
        (Configure(1, 0.1, Reaction.BRAKE), Configure(1, 0.1, Reaction.BRAKE)),
        (Configure(2, 0.1, Reaction.BRAKE), None),
        (Sync(3, (0, 1, 2, 5)), Sync(3, (1, 5))),
        (Sync(3, (0, 2)), None),
        (Sync(3, ()), Sync(3, ())),
        (Alive((4, 5)), Alive((5,))),
        (EmergencyStop((1, 2)), EmergencyStop((1,))),
        (EmergencyStop((0,)), None),
        (Rejected("cut"), Rejected("cut")),
    ],
)
def test_a_message_says_on_its_bus_what_concerns_the_legs_of_that_bus(message, heard):
    protocol, family = several()
    family.messages = (message, Rejected("second"))
    _, messages = protocol.parse((0, 0, 0), on(1, 10, b""))
    assert messages == ((Rejected("second"),) if heard is None else (heard, Rejected("second")))


def test_a_command_is_heard_on_the_bus_of_its_legs_and_one_for_no_leg_nowhere():
    protocol, family = several()
    for legs, heard in (((1, 5), 1), ((5,), 1), ((0, 4), 0), ((), 0)):
        family.messages = (command(*legs),)
        assert len(protocol.parse((0, 0, 0), on(1, 10, b""))[1]) == heard


def test_the_drives_of_each_bus_answer_by_their_own_memory_what_they_are_given():
    protocol, family = several()
    given = [object() for _ in range(5)]
    sync = Sync(7, (5, 2, 3))
    memory, frames = protocol.answer((10, 20, 30), sync, *given)
    assert memory == (10, 21, 31)
    assert frames == [(5, on(1, 5, b"\x14")), (2, on(2, 2, b"\x1e")), (3, on(2, 3, b"\x1e"))]
    assert family.asked == [(sync, *given)] * 2


@pytest.mark.parametrize("leg", range(6))
def test_a_heartbeat_is_that_of_the_memory_of_its_bus_and_goes_there(leg):
    protocol, _ = several()
    bus = HOME[leg]
    memory, frames = protocol.report((10, 20, 30), Status(leg, DriveState.OFF, 0))
    assert memory == tuple(10 + 10 * k + (k == bus) for k in range(3))
    assert frames == (on(bus, leg, bytes((10 + 10 * bus,))), on(bus, leg, b"", FD))


def test_drives_that_were_switched_off_and_on_are_forgotten_on_their_own_buses():
    protocol, _ = several()
    assert protocol.restarted((10, 20, 30), (5, 0, 4)) == ((10, (0, 4)), (20, (5,)), (30, ()))


def test_a_drive_is_asked_who_it_is_and_says_it_on_its_own_bus():
    protocol, _ = several()
    asked = (on(0, 4, b"serial"), on(2, 2, b"serial")), (on(1, 1, b"version"),)
    assert protocol.identity_requests() == asked
    assert [protocol.identity(on(bus, 5, b"x")) for bus in range(3)] == [None, Said(5, SERIAL, 7), None]
    assert protocol.identity(on(1, 9, b"x")) is None
    nameless: Any = SimpleNamespace()
    assert not isinstance(nameless, Identified)
    silent = SeveralBuses(nameless, BUSES)
    assert (silent.identity_requests(), silent.identity(on(1, 5, b"x"))) == ((), None)
