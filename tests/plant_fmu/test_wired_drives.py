"""Drives of the rehearsal that have no power or no bus, or speak another protocol, answer nobody."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.config import TransmissionSettings
from drivers.legs.protocol import LegsProtocol
from drivers.mit.fields import Ranges
from drivers.protocol import EXTENDED, REMOTE, Frame, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record
from drivers.transmission import Transmission
from plant_fmu.drives import drives_end
from plant_fmu.drives.ends import DrivesEnd
from plant_fmu.messages import Alive, Answer, Configure, DeviceCommand, EmergencyStop, Status, Sync
from plant_fmu.rehearsal.wired_drives import WiredEnd, wired_drives
from plant_fmu.rehearsal.wiring import Wiring
from tests.drivers.by_value import ByValue
from tests.drivers.cia402_drives import drives
from tests.drivers.drives_end import reading_of
from tests.drivers.legs_frames import command_frames, decode, opening
from tests.drivers.motor_families import MitProtocol, ODriveProtocol, RobStrideProtocol

NODES = (1, 2, 3, 4, 5, 6)
GEAR = Transmission.of(TransmissionSettings(lead_m=0.1))
RANGES = Ranges(95.5, 400.0, 500.0, 5.0, 144.0)


def asked(name: str) -> tuple[Any, list[Frame]]:
    """Return a codec, and a request to each drive that is answered at once, by no feedback."""
    if name == "cia402":  # upload of 0x1000
        return ByValue(drives(NODES)), [
            Frame(0x600 + node, bytes.fromhex("4000100000000000")) for node in NODES
        ]
    if name == "damiao":  # read register 9
        protocol = MitProtocol("damiao", RANGES, NODES, 16, GEAR)
        return protocol, [Frame(0x7FF, bytes((node, 0, 0x33, 9, 0, 0, 0, 0))) for node in NODES]
    if name == "robstride":  # who are you
        other = RobStrideProtocol(RANGES, NODES, 253, GEAR)
        return other, [Frame(253 << 8 | node, bytes(8), EXTENDED) for node in NODES]
    return ODriveProtocol(NODES, 0.05, GEAR), [Frame(node << 5 | 0x06, b"", REMOTE) for node in NODES]


def wirings(mute: int) -> list[Wiring]:
    """Return those in which one drive is there in no way."""
    there = tuple(leg != mute for leg in range(LEGS))
    return [Wiring(present=there), Wiring(other_protocol=tuple(not each for each in there))]


def answering(name: str, wiring: Wiring) -> list[int]:
    """Return the drives that answer a request to each, once they have booted."""
    protocol, frames = asked(name)
    wired = ByValue(wired_drives(protocol.protocol, wiring, NODES))
    memory = protocol.power_up()
    for leg in range(LEGS):
        memory, _ = protocol.report(memory, Status(leg, DriveState.BOOT, 0))
    found = []
    for frame in frames:
        memory, messages = wired.parse(memory, frame)
        found += [each.leg for each in messages if isinstance(each, Answer)]
    return found


@pytest.mark.parametrize("name", ["cia402", "damiao", "robstride", "odrive"])
def test_a_request_is_answered_by_the_drives_that_are_there_and_by_no_other(name):
    assert answering(name, Wiring()) == list(range(LEGS))
    for mute in range(LEGS):
        for wiring in wirings(mute):
            assert answering(name, wiring) == [leg for leg in range(LEGS) if leg != mute]


@pytest.mark.parametrize("name", ["cia402", "damiao", "robstride", "odrive"])
def test_a_number_that_no_drive_was_given_is_answered_by_nobody(name):
    assert answering(name, Wiring(answers_as=(0, 1, 3, 3, 4, 5))) == [0, 1, 3, 4, 5]


def test_a_drive_without_power_says_nothing_of_its_state_either():
    protocol, _ = asked("odrive")
    memory = protocol.power_up()
    zeros = np.zeros(LEGS)
    for mute in range(LEGS):
        wired = ByValue(wired_drives(protocol.protocol, wirings(mute)[0], NODES))
        reports = [wired.report(memory, Status(leg, DriveState.OFF, 0))[1] for leg in range(LEGS)]
        assert [leg for leg, frames in enumerate(reports) if not frames] == [mute]
        sync = wired.parse(memory, Frame(NODES[mute] << 5 | 0x09, b"", REMOTE))[1]
        assert sync == ()
        everybody = protocol.parse(memory, Frame(NODES[mute] << 5 | 0x09, b"", REMOTE))[1][0]
        _, answers = wired.answer(
            memory, everybody._replace(legs=tuple(range(LEGS))), zeros, zeros, zeros, zeros.astype(int)
        )
        assert [leg for leg, _ in answers] == [leg for leg in range(LEGS) if leg != mute]


@pytest.mark.parametrize(("first", "second"), [(2, 3), (3, 2), (0, 5), (5, 0)])
def test_two_drives_of_one_number_say_each_its_own(first, second):
    """`second` was given the number of `first`: both answer under it, with what each measures."""
    number = tuple(first if drive == second else drive for drive in range(LEGS))
    protocol = ByValue(LegsProtocol("fd", NODES))
    wired = ByValue(wired_drives(protocol.protocol, Wiring(answers_as=number), NODES))
    sync: Any = protocol.parse(protocol.power_up(), opening(protocol.protocol, 1)[0])[1][0]
    length, rate = np.linspace(1.0, 1.5, LEGS), np.linspace(0.0, 0.05, LEGS)
    force, state = np.linspace(0.0, 500.0, LEGS), np.array([DriveState.OFF] * LEGS)
    state[second] = DriveState.READY
    _, answers = wired.answer(protocol.power_up(), sync, length, rate, force, state)
    assert [drive for drive, _ in answers] == list(range(LEGS))
    for drive, frame in answers:
        said = decode(protocol.protocol, [Received(0, frame)], 1)
        leg = number[drive]
        assert said["length"][leg] == pytest.approx(length[drive], abs=1e-6)
        assert said["rate"][leg] == pytest.approx(rate[drive], abs=1e-6)
        assert said["drive_force"][leg] == pytest.approx(force[drive], abs=2.0)
        assert said["drive_state"][leg] == state[drive]


@pytest.mark.parametrize("number", [(0, 1, 2, 3, 4, 5), (1, 0, 2, 5, 3, 4)])
def test_a_watchdog_takes_its_multiple_of_what_the_drive_was_told_and_the_drive_confirms_what_it_was_told(
    number,
):
    """inf: it never ends, in a million seconds."""
    factors = (1.0, 8.0, 0.3, inf, 2.5, 0.5)
    protocol = ByValue(LegsProtocol("fd", NODES))
    given = wired_drives(protocol.protocol, Wiring(answers_as=number, watchdog=factors), NODES)
    wired = ByValue(given)
    wired_end: Any = drives_end(given)
    memory = protocol.power_up()
    for frame in protocol.configure(0.01, Reaction.DAMP):
        ((_, (said,)), (_, heard)) = protocol.parse(memory, frame), wired.parse(memory, frame)
        assert isinstance(said, Configure)
        drive = number.index(said.leg)
        waits = 0.01 + 1e6 if factors[drive] == inf else 0.01 * factors[drive]
        (told,) = heard
        assert isinstance(told, Configure)
        assert (told.leg, told.reaction) == (drive, Reaction.DAMP)
        assert told.watchdog_s == pytest.approx(waits, rel=1e-12)
        assert wired_end._told(drive, told.watchdog_s) == pytest.approx(0.01, rel=1e-12)
        _, confirmed = wired.report(memory, Status(drive, DriveState.OFF, 0, told))
        assert confirmed == protocol.report(memory, Status(said.leg, DriveState.OFF, 0, said))[1]


@pytest.mark.parametrize("mute", range(6))
def test_a_drive_as_delivered_says_that_it_is_pre_operational_under_its_number_and_nothing_else(mute):
    """CiA 301: heartbeat 0x7F."""
    protocol, numbers = ByValue(LegsProtocol("fd", NODES)), (11, 12, 13, 14, 15, 16)
    wired = ByValue(wired_drives(protocol.protocol, wirings(mute)[1], numbers))
    memory = protocol.power_up()
    said = [wired.report(memory, Status(leg, DriveState.OFF, 0))[1] for leg in range(LEGS)]
    assert said[mute] == (Frame(0x70B + mute, b"\x7f"),)
    for leg in set(range(LEGS)) - {mute}:
        assert said[leg] == protocol.report(memory, Status(leg, DriveState.OFF, 0))[1]
    sync: Any = protocol.parse(memory, opening(protocol.protocol, 1)[0])[1][0]
    zeros = np.zeros(LEGS)
    _, answers = wired.answer(memory, sync, zeros, zeros, zeros, zeros.astype(int))
    assert [drive for drive, _ in answers] == [leg for leg in range(LEGS) if leg != mute]


@pytest.mark.parametrize("layout", ["classic", "fd"])
def test_a_command_reaches_who_answers_to_its_number_with_the_force_that_is_meant_for_that(layout):
    """Two answer to number 3, nobody to 2; one has no power, and one speaks another protocol."""
    number = (1, 0, 3, 3, 4, 5)
    wiring = Wiring(
        answers_as=number,
        present=(True, True, True, True, False, True),
        other_protocol=(False, False, False, False, False, True),
    )
    protocol = ByValue(LegsProtocol(layout, NODES))
    wired = ByValue(wired_drives(protocol.protocol, wiring, NODES))
    memory, _ = protocol.parse(protocol.power_up(), opening(protocol.protocol, 7)[0])
    given: dict[int, float] = {}
    for frame in command_frames(protocol.protocol, Command(DriveMode.RUN, 100.0 * np.arange(6.0) - 250.0), 7):
        (message,) = wired.parse(memory, frame)[1]
        assert isinstance(message, DeviceCommand)
        assert message.mode == DriveMode.RUN
        given |= dict(zip(message.legs, message.force.tolist(), strict=True))
    assert given == pytest.approx({0: -150.0, 1: -250.0, 2: 50.0, 3: 50.0}, abs=2.0)


class Family(DrivesEnd):
    """A protocol and its drives' end, which keeps what it is given; its frames say for which leg they are."""

    traits = SimpleNamespace(unasked_s=0.125)

    def __init__(self, *messages: Any) -> None:
        self.messages = messages
        self.restarts: list[list[int]] = []
        self.given: list[tuple[Any, ...]] = []

    def drives_end(self) -> Family:
        return self

    def hear(self, _frame: Frame) -> tuple[Any, ...]:
        return self.messages

    def reply(self, sync: Sync, reading: Record) -> list[tuple[int, Frame]]:
        self.given.append((sync.legs, *(each.tolist() for each in reading.tolist())))
        return [(leg, Frame(leg, b"")) for leg in range(LEGS)]

    def restart(self, legs: Sequence[int]) -> None:
        self.restarts.append(list(legs))

    def announce(self, _status: Status) -> Any:
        raise NotImplementedError


CROSSED = Wiring(
    answers_as=(1, 0, 3, 3, 4, 5),
    present=(True, True, True, True, False, True),
    other_protocol=(False, False, False, False, False, True),
)
"""Two answer to number 3, nobody to 2; drives 4 and 5 are there in no way."""


def wired_to(wiring: Wiring, *messages: Any) -> tuple[WiredEnd, Family]:
    family: Any = Family(*messages)
    return WiredEnd(family, wiring, NODES), family


@pytest.mark.parametrize("kind", [lambda legs: Sync(9, legs), Alive, EmergencyStop])
@pytest.mark.parametrize(
    ("legs", "drives_"), [((0, 1, 2, 3, 4, 5), (0, 1, 2, 3)), ((1,), (0,)), ((3, 5), (2, 3)), ((2, 4), None)]
)
def test_a_sync_a_sign_of_life_and_a_stop_reach_who_answers_to_their_numbers(kind, legs, drives_):
    wired, _ = wired_to(CROSSED, kind(legs))
    expected = () if drives_ is None else (kind(legs)._replace(legs=drives_),)
    assert wired.hear(Frame(1, b"")) == expected


def test_drives_that_are_wired_right_hear_what_is_said_as_it_is():
    for wiring in (Wiring(), Wiring(scale=(2.0,) * 6)):
        messages = (Alive((2, 4)), Configure(3, 0.02, Reaction.HOLD))
        wired, _ = wired_to(wiring, *messages)
        assert wired.hear(Frame(1, b"")) == messages
    for factors in ((1.0, 1.0, 1.0, 2.0, 1.0, 1.0), (2.0,) * 6):
        wired, _ = wired_to(Wiring(watchdog=factors), Configure(3, 0.02, Reaction.HOLD))
        assert wired.hear(Frame(1, b"")) == (Configure(3, 0.04, Reaction.HOLD),)


def test_drives_that_are_wired_right_answer_with_what_they_measure_as_it_is():
    wired, family = wired_to(Wiring(scale=(2.0,) * 6))
    length, rate, force = (10.0 * k + np.arange(6.0) for k in range(3))
    state, fault = np.arange(6), 6 - np.arange(6)
    answers = wired.reply(Sync(9, (0, 2, 4)), reading_of(length, rate, force, state, fault))
    assert len(answers) == LEGS
    given = (length, rate, force, state, fault)
    assert family.given == [((0, 2, 4), *(each.tolist() for each in given))]


def test_drives_that_start_again_are_those_of_their_numbers_and_the_period_is_the_familys():
    wired, family = wired_to(CROSSED)
    given: Any = family
    assert wired_drives(given, CROSSED, NODES).traits.unasked_s == 0.125
    wired.restart([0, 2, 3])
    assert family.restarts == [[1, 3, 3]]


def test_what_a_drive_measures_and_its_fault_stand_at_the_number_that_it_answers_to():
    figures = [10.0 * k + np.arange(6.0) for k in range(1, 4)]
    state, fault = np.arange(6), 6 - np.arange(6)
    given = (*figures, state, fault)
    wired, family = wired_to(CROSSED)
    answers = wired.reply(Sync(9, (0, 2, 4)), reading_of(figures[0], figures[1], figures[2], state, fault))
    assert [(drive, frame.id) for drive, frame in answers] == [(0, 1), (2, 3)]
    for (drive, number), (legs, *seen) in zip(((0, 1), (2, 3)), family.given, strict=True):
        assert legs == (number,)
        assert [each[number] for each in seen] == [each[drive] for each in given]


@pytest.mark.parametrize("factor", [1.0, 2.0, 0.5, inf])
def test_a_drive_confirms_every_time_in_ms_as_it_was_told_it(factor):
    wired, _ = wired_to(Wiring(watchdog=(1.0, 1.0, 1.0, factor, 1.0, 1.0)))
    heard = [wired._told(3, wired._waits(3, ms / 1000)) for ms in range(1, 1001)]
    assert heard == [ms / 1000 for ms in range(1, 1001)]


@pytest.mark.parametrize("leg", range(LEGS))
def test_all_that_one_frame_says_reaches_its_drive_in_its_order(leg):
    protocol = MitProtocol("damiao", RANGES, NODES, 16, GEAR).protocol
    wired: Any = drives_end(wired_drives(protocol, Wiring(watchdog=(8.0,) * LEGS), NODES))
    held, *commands, poll = wired.hear(Frame(NODES[leg], b"\xff" * 7 + b"\xfc"))
    assert isinstance(held, Configure)
    assert held.leg == leg
    assert [(each.legs, each.mode) for each in commands] == [
        ((leg,), DriveMode.READY),
        ((leg,), DriveMode.RUN),
    ]
    assert poll == Sync(0, (leg,))
