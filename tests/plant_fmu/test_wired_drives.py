"""Drives of the rehearsal without power, with another node number or protocol, or with a wrong watchdog."""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np
import pytest

from drivers.config import DriveSettings
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, DriveMode, DriveState, Reaction
from plant_fmu.config import DriveEmulation
from plant_fmu.rehearsal.bench import WiredNodes
from plant_fmu.rehearsal.wiring import Wiring
from tests.drivers.legs_frames import decode, opening
from tests.plant_fmu.rig import MS, REST, Masses, Rig

NODES = (1, 2, 3, 4, 5, 6)
BEAT_NS = 100 * MS
CROSSED = Wiring(
    answers_as=(1, 0, 3, 3, 4, 5),
    present=(True, True, True, True, False, True),
    other_protocol=(False, False, False, False, False, True),
)
"""Two drives have number 3, none has 2; drive 4 has no power, drive 5 another protocol."""


def wired(wiring: Wiring, protocol: Any, node_ids: Any = NODES) -> WiredNodes:
    settings = DriveSettings(node_ids=list(node_ids))
    exact = DriveEmulation(encoder_resolution_m=0.0)
    nodes = WiredNodes(wiring, Masses(), protocol, exact, settings)
    nodes.start(0)
    return nodes


class WiredRig(Rig):
    """A rig with wired drives."""

    def __init__(self, wiring: Wiring, layout: str = "fd") -> None:
        super().__init__(layout)
        self.nodes = wired(wiring, self.protocol)


@pytest.mark.parametrize("mute", range(LEGS))
def test_a_drive_with_factory_settings_sends_only_canopen_heartbeats(mute):
    """CiA 301: heartbeat 0x7F, pre-operational."""
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
def test_two_drives_with_the_same_node_number_both_send_their_own_length(first, second):
    """`second` has the number of `first`: both answer under it, each with its own measurement."""
    number = tuple(first if drive == second else drive for drive in range(LEGS))
    rig = WiredRig(Wiring(answers_as=number))
    sent = rig.at(0, *opening(rig.protocol, 1))
    answers = [frame for _, frame in sent if frame.id < 0x700]
    assert [frame.id - 0x281 for frame in answers] == list(number)
    for drive, frame in enumerate(answers):
        said = decode(rig.protocol, [Received(0, frame)], 1)
        assert said["length"][number[drive]] == pytest.approx(REST[drive], abs=1e-6)


@pytest.mark.parametrize("number", [(0, 1, 2, 3, 4, 5), (1, 0, 2, 5, 3, 4)])
def test_drive_whose_watchdog_has_a_wrong_time_still_confirms_the_configured_time(number):
    """inf: the watchdog never ends."""
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
def test_commands_and_emergency_stops_reach_every_drive_with_the_addressed_node_number(layout):
    rig = WiredRig(CROSSED, layout)
    rig.configure()
    rig.command(0, DriveMode.READY, (100.0 * np.arange(6.0) - 250.0).tolist())
    ready, boot = DriveState.READY, DriveState.BOOT
    assert rig.states == [ready, ready, ready, ready, boot, boot]
    assert rig.nodes.snapshot().command.tolist() == pytest.approx([-150, -250, 50, 50, 0, 0], abs=2.0)
    assert rig.nodes.syncs == 1
    rig.at(MS, *rig.protocol.traits.emergency_stop)
    assert rig.states == [DriveState.FAULT] * 4 + [DriveState.BOOT] * 2
