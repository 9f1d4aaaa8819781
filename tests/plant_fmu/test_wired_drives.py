"""Drives of the rehearsal that have no power, another number or protocol, or a wrong watchdog."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
import pytest

from drivers.config import DriveSettings, TransmissionSettings
from drivers.legs.protocol import LegsProtocol
from drivers.mit.fields import Ranges
from drivers.protocol import EXTENDED, REMOTE, Frame, Received
from drivers.signals import LEGS, DriveMode, DriveState, Reaction
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.legs import LegsDrives
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import DriveReset
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.rehearsal.wired_drives import WiredNodes
from plant_fmu.rehearsal.wiring import Wiring
from tests.drivers.cia402_drives import drives
from tests.drivers.legs_frames import decode, opening
from tests.drivers.motor_families import MitProtocol, ODriveProtocol, RobStrideProtocol
from tests.plant_fmu.test_drive_messages import Asked, Unasked
from tests.plant_fmu.test_nodes import MS, REST, Masses, Rig

NODES = (1, 2, 3, 4, 5, 6)
GEAR = Transmission(TransmissionSettings(lead_m=0.1))
RANGES = Ranges(95.5, 400.0, 144.0)
BEAT_NS = 100 * MS
CROSSED = Wiring(
    answers_as=(1, 0, 3, 3, 4, 5),
    present=(True, True, True, True, False, True),
    other_protocol=(False, False, False, False, False, True),
)
"""Two answer to number 3, nobody to 2; drives 4 and 5 are there in no way."""


def wired(wiring: Wiring, protocol: Any, *faults: Fault, node_ids: Any = NODES) -> WiredNodes:
    settings = DriveSettings(node_ids=list(node_ids))
    exact = DriveEmulation(encoder_resolution_m=0.0)
    nodes = WiredNodes(wiring, Masses(), protocol, exact, settings, FaultPlan(faults))
    nodes.start(0)
    return nodes


class WiredRig(Rig):
    """A rig whose drives are wired."""

    def __init__(self, wiring: Wiring, layout: str = "fd") -> None:
        super().__init__(layout)
        self.nodes = wired(wiring, self.protocol)


def asked(name: str) -> tuple[Any, list[Frame]]:
    """Return a codec, and a request to each drive that is answered at once, by no feedback."""
    if name == "cia402":  # upload of 0x1000
        return drives(NODES), [Frame(0x600 + node, bytes.fromhex("4000100000000000")) for node in NODES]
    if name == "damiao":  # read register 9
        protocol = MitProtocol("damiao", RANGES, NODES, 16, GEAR).protocol
        return protocol, [Frame(0x7FF, bytes((node, 0, 0x33, 9, 0, 0, 0, 0))) for node in NODES]
    if name == "robstride":  # who are you
        other = RobStrideProtocol(RANGES, NODES, 253, GEAR).protocol
        return other, [Frame(253 << 8 | node, bytes(8), EXTENDED) for node in NODES]
    return ODriveProtocol(NODES, 0.05, GEAR).protocol, [Frame(node << 5 | 6, b"", REMOTE) for node in NODES]


def answering(name: str, wiring: Wiring) -> list[int]:
    """Return the numbers under which a request is answered, once the drives have booted."""
    protocol, frames = asked(name)
    nodes = wired(wiring, protocol)
    nodes.step(2 * BEAT_NS, [])
    sent = [
        nodes.step(2 * BEAT_NS + k, [Received(2 * BEAT_NS + k, each)]) for k, each in enumerate(frames, 1)
    ]
    return [leg for leg, each in enumerate(sent) if each]


@pytest.mark.parametrize("name", ["cia402", "damiao", "robstride", "odrive"])
def test_a_request_is_answered_by_the_drives_that_are_there_and_by_no_other(name):
    assert answering(name, Wiring()) == list(range(LEGS))
    for mute in range(LEGS):
        there = tuple(leg != mute for leg in range(LEGS))
        for wiring in (Wiring(present=there), Wiring(other_protocol=tuple(not each for each in there))):
            assert answering(name, wiring) == [leg for leg in range(LEGS) if leg != mute]


@pytest.mark.parametrize("name", ["cia402", "damiao", "robstride", "odrive"])
def test_a_number_that_no_drive_was_given_is_answered_by_nobody(name):
    assert answering(name, Wiring(answers_as=(0, 1, 3, 3, 4, 5))) == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("mute", range(LEGS))
def test_a_drive_without_power_sends_neither_its_state_nor_feedback(mute):
    rig = WiredRig(Wiring(present=tuple(leg != mute for leg in range(LEGS))))
    others = [leg for leg in range(LEGS) if leg != mute]
    assert [frame.id - 0x701 for _, frame in rig.at(BEAT_NS - 1)] == others
    sent = rig.at(BEAT_NS - 1, *opening(rig.protocol, 1))
    assert [frame.id - 0x281 for _, frame in sent] == others


@pytest.mark.parametrize("mute", range(LEGS))
def test_a_drive_as_delivered_says_that_it_is_pre_operational_under_its_number_and_nothing_else(mute):
    """CiA 301: heartbeat 0x7F."""
    other = tuple(leg == mute for leg in range(LEGS))
    protocol = LegsProtocol("fd", NODES)
    nodes = wired(Wiring(other_protocol=other), protocol, node_ids=(11, 12, 13, 14, 15, 16))
    right = wired(Wiring(), protocol)
    sent, expected = nodes.step(BEAT_NS - 1, []), right.step(BEAT_NS - 1, [])
    assert sent[mute] == (expected[mute][0], Frame(0x70B + mute, b"\x7f"))
    assert [each for leg, each in enumerate(sent) if leg != mute] == [
        each for leg, each in enumerate(expected) if leg != mute
    ]
    answers = nodes.step(BEAT_NS - 1, [Received(BEAT_NS - 1, frame) for frame in opening(protocol, 1)])
    assert [frame.id - 0x281 for _, frame in answers] == [leg for leg in range(LEGS) if leg != mute]


@pytest.mark.parametrize(("first", "second"), [(2, 3), (3, 2), (0, 5), (5, 0)])
def test_two_drives_of_one_number_say_each_its_own(first, second):
    """`second` was given the number of `first`: both answer under it, with what each measures."""
    number = tuple(first if drive == second else drive for drive in range(LEGS))
    rig = WiredRig(Wiring(answers_as=number))
    sent = rig.at(0, *opening(rig.protocol, 1))
    answers = [frame for _, frame in sent if frame.id < 0x700]
    assert [frame.id - 0x281 for frame in answers] == list(number)
    for drive, frame in enumerate(answers):
        said = decode(rig.protocol, [Received(0, frame)], 1)
        assert said["length"][number[drive]] == pytest.approx(REST[drive], abs=1e-6)


@pytest.mark.parametrize("number", [(0, 1, 2, 3, 4, 5), (1, 0, 2, 5, 3, 4)])
def test_a_watchdog_takes_its_multiple_of_what_was_set_and_the_drive_confirms_what_was_set(number):
    """inf: it never ends."""
    factors = (1.0, 8.0, 0.3, inf, 2.5, 0.5)
    rig, right = WiredRig(Wiring(answers_as=number, watchdog=factors)), Rig()
    rig.at(0)
    right.at(0)
    confirmed = [each.at(1, *each.protocol.configure(0.01, Reaction.BRAKE)) for each in (rig, right)]
    assert sorted(confirmed[0]) == sorted(confirmed[1])
    rig.command(1, DriveMode.READY)
    for ms in (2.9, 3.1, 4.9, 5.1, 9.9, 10.1, 24.9, 25.1, 79.9, 80.1, 10_000.0):
        rig.at(round(ms * MS))
        expected = [DriveState.FAULT if 10.0 * factor < ms else DriveState.READY for factor in factors]
        assert rig.states == expected, ms


@pytest.mark.parametrize("layout", ["classic", "fd"])
def test_a_command_reaches_who_answers_to_its_number_with_the_force_that_is_meant_for_that(layout):
    rig = WiredRig(CROSSED, layout)
    rig.configure()
    rig.command(0, DriveMode.READY, (100.0 * np.arange(6.0) - 250.0).tolist())
    ready, boot = DriveState.READY, DriveState.BOOT
    assert rig.states == [ready, ready, ready, ready, boot, boot]
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([-150, -250, 50, 50, 0, 0], abs=2.0)
    assert rig.nodes.syncs == 1


def test_a_stop_reaches_the_drives_that_are_there():
    rig = WiredRig(CROSSED)
    rig.configure()
    rig.at(MS, *rig.protocol.traits.emergency_stop)
    assert rig.states == [DriveState.FAULT] * 4 + [DriveState.BOOT] * 2


def test_a_sign_of_life_feeds_those_that_answer_to_its_number():
    rig = WiredRig(CROSSED)
    rig.nodes = wired(CROSSED, Asked("fd", NODES))
    rig.configure()
    rig.command(0, DriveMode.READY)
    rig.at(6 * MS, Frame(0x7FE, bytes((1, 2, 3))))
    rig.at(12 * MS)
    over, ready, boot = DriveState.FAULT, DriveState.READY, DriveState.BOOT
    assert rig.states == [ready, over, ready, ready, boot, boot]


def test_a_frame_to_a_number_that_nobody_has_is_neither_obeyed_nor_repeated():
    rig = WiredRig(Wiring(present=(False,) * LEGS))
    rig.run()
    snapshot = rig.nodes.snapshot()
    assert (snapshot.syncs, snapshot.commands, snapshot.repeated, snapshot.rejected) == (0, 0, 0, 0)


def test_drives_that_speak_unasked_do_so_under_their_number_if_they_are_there():
    nodes = wired(CROSSED, Unasked("fd", NODES))
    sent = [frame.id - 0x281 for _, frame in nodes.step(6 * MS, []) if frame.id < 0x700]
    assert sent == [1, 0, 3, 3]


def test_drives_that_start_again_are_those_of_their_numbers():
    restarts: list[list[int]] = []

    class Noting(LegsDrives):
        def restart(self, legs: Any) -> None:
            restarts.append(list(legs))

    class Family(LegsProtocol):
        def drives_end(self) -> LegsDrives:
            return Noting(self)

    resets = [DriveReset(leg=leg, at_s=0.01) for leg in (0, 2, 3, 4)]
    nodes = wired(CROSSED, Family("fd", NODES), *resets)
    restarts.clear()
    nodes.step(10 * MS, [])
    assert restarts[0] == [1, 3, 3]


@pytest.mark.parametrize("leg", range(LEGS))
def test_all_that_one_frame_says_reaches_its_drive_in_its_order(leg):
    """Enabled, a Damiao is set up, goes through READY to RUN, and answers."""
    protocol = MitProtocol("damiao", RANGES, NODES, 16, GEAR).protocol
    nodes = wired(Wiring(watchdog=(8.0,) * LEGS), protocol)
    sent = nodes.step(MS, [Received(MS, Frame(NODES[leg], b"\xff" * 7 + b"\xfc"))])
    assert [(t, frame.data[0] & 0xF) for t, frame in sent] == [(MS, NODES[leg])]
    assert nodes.snapshot().state.tolist() == [
        DriveState.RUN if each == leg else DriveState.BOOT for each in range(LEGS)
    ]
