"""What drives say by themselves and when they are asked: each for itself, at its instant."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest

from drivers.arrays import array_at
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import FAILED, Pointed, of_python
from drivers.config import DriveSettings
from drivers.frame_array import FRAME
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received, Traits
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, Status
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.ends import ALIVE
from plant_fmu.drives.legs import LegsDrives
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.kinds import DriveSilence
from plant_fmu.faults.plan import FaultPlan
from tests.drivers.legs_frames import command_frames, opening
from tests.plant_fmu.test_nodes import MS, Masses, Rig


def test_each_heartbeat_says_state_fault_and_set_up_of_its_own_drive():
    """Leg 0 is not set up; the others are READY until their watchdogs end, in ms: 5, 50, 20, 300, 10."""
    rig = Rig()
    sets = [
        Configure(leg, 1e-3 * ms, Reaction(leg % 4)) for leg, ms in enumerate((1, 5, 50, 20, 300, 10)) if leg
    ]
    sent = rig.at(0, *[rig.protocol.configure(each.watchdog_s, each.reaction)[each.leg] for each in sets])
    sent += rig.command(0, DriveMode.READY) + rig.at(99 * MS)
    ready, over = (DriveState.READY, DriveFault.NONE), (DriveState.FAULT, DriveFault.WATCHDOG)
    said = ((DriveState.BOOT, DriveFault.NONE), over, ready, over, ready, over)
    for leg, (state, fault) in enumerate(said):
        beats = [frame for t, frame in sent if t == round(leg * 100 * MS / 6) and frame.id == 0x701 + leg]
        status = Status(leg, state, fault, sets[leg - 1] if leg else None, True)
        assert beats == list(reports(rig.protocol, status)), leg


class Unasked(LegsProtocol):
    """Drives that each say what they measure every 6 ms."""

    @cached_property
    def traits(self) -> Traits:
        return replace(super().traits, unasked_s=6e-3)


@pytest.mark.parametrize("t0_ns", [0, 7 * MS + 3])
def test_drives_that_speak_unasked_do_so_one_sixth_of_their_period_after_the_other_from_the_first_on(t0_ns):
    protocol = Unasked("fd", (1, 2, 3, 4, 5, 6))
    nodes = Nodes(Masses(), protocol, DriveEmulation(), DriveSettings())
    nodes.start(t0_ns)
    sent = [(t - t0_ns, frame.id) for t, frame in nodes.step(t0_ns + 8 * MS, []) if frame.id < 0x700]
    assert sent == [(k * MS, 0x281 + (k - 1) % 6) for k in range(1, 9)]


class Asked(LegsProtocol):
    """Drives that know two frames more: a sign of life, and a request that one of them answers."""

    def drives_end(self) -> LegsDrives:
        return AskedDrives(self)


class AskedDrives(LegsDrives):
    def __init__(self, family: LegsProtocol) -> None:
        super().__init__(family)
        self._decode = self.parse
        address, self._keeps = of_python(self._look, *[INTEGER] * 3)
        self.parse = Pointed(address, ("", b""), self._look)

    def _look(self, end: int, frame_at: int, messages: int) -> int:
        (frame,) = array_at(frame_at, 1, FRAME)
        return FAILED if frame["id"] in (0x7FE, 0x7FF) else self._decode.raw(end, frame_at, messages)

    def converse(self, frame: Frame) -> None:
        if frame.id == 0x7FE:
            self.put(ALIVE, tuple(frame.data))
        elif frame.id == 0x7FF:
            self.say(frame.data[0], Frame(0x6A0 + frame.data[0], b"here"))
        else:
            super().converse(frame)


def test_a_sign_of_life_feeds_the_watchdogs_of_those_that_it_is_for():
    rig = Rig()
    rig.protocol = Asked("fd", (1, 2, 3, 4, 5, 6))
    rig.nodes = Nodes(rig.plant, rig.protocol, DriveEmulation(), DriveSettings())
    rig.nodes.start(0)
    rig.configure()
    rig.command(0, DriveMode.READY)
    rig.at(6 * MS, Frame(0x7FE, bytes((1, 4))))
    rig.at(12 * MS)
    over, ready = DriveState.FAULT, DriveState.READY
    assert rig.states == [over, ready, over, over, ready, over]
    rig.at(17 * MS)
    assert rig.states == [over] * 6


def test_a_request_is_answered_by_its_drive_at_its_instant_unless_that_is_silent():
    protocol = Asked("fd", (1, 2, 3, 4, 5, 6))
    for mute in range(6):
        nodes = Nodes(
            Masses(), protocol, DriveEmulation(), DriveSettings(), FaultPlan([DriveSilence(leg=mute)])
        )
        nodes.start(0)
        asked = [Received(MS + leg, Frame(0x7FF, bytes((leg,)))) for leg in range(6)]
        sent = [(t, frame) for t, frame in nodes.step(2 * MS, asked) if frame.id < 0x700]
        assert sent == [(MS + leg, Frame(0x6A0 + leg, b"here")) for leg in range(6) if leg != mute]


def test_a_status_is_due_at_its_heartbeat_and_not_where_something_has_changed():
    said: list[tuple[int, bool]] = []

    class ReportingDrives(LegsDrives):
        def __init__(self, family: LegsProtocol) -> None:
            super().__init__(family)
            self._reports = self.report
            address, self._keeps = of_python(self._note, *[INTEGER] * 8)
            self.report = Pointed(address, ("", b""), self._note)

        def _note(self, *given: int) -> int:
            said.append((given[1], bool(given[6])))
            return int(self._reports.raw(*given))

    class Reporting(LegsProtocol):
        def drives_end(self) -> LegsDrives:
            return ReportingDrives(self)

    protocol = Reporting("fd", (1, 2, 3, 4, 5, 6))
    nodes = Nodes(Masses(), protocol, DriveEmulation(), DriveSettings())
    nodes.start(0)
    said.clear()
    nodes.step(1, [Received(1, frame) for frame in protocol.configure(0.01, Reaction.DAMP)])
    assert said == [(0, True), *((leg, False) for leg in range(6))]
    said.clear()
    nodes.step(100 * MS - 1, [])
    assert said == [(leg, True) for leg in range(1, 6)]


def test_a_frame_that_comes_late_is_heard_where_the_drives_are_by_now_and_feeds_their_watchdogs_from_there():
    rig = Rig()
    rig.configure(watchdog_s=0.01)
    rig.at(5 * MS)
    command = Command(DriveMode.READY, np.zeros(6))
    late = [*opening(rig.protocol, 1), *command_frames(rig.protocol, command, 1)]
    sent = rig.nodes.step(6 * MS, [Received(MS, frame) for frame in late])
    assert [(t, frame.id) for t, frame in sent if frame.id < 0x700] == [(5 * MS, 0x281 + k) for k in range(6)]
    assert rig.nodes.now_ns == 6 * MS
    for t_ns, state in ((15 * MS, DriveState.READY), (15 * MS + 1, DriveState.FAULT)):
        rig.at(t_ns)
        assert rig.nodes.snapshot().state.tolist() == [state] * 6
