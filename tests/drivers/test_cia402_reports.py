"""CiA 402: what a drive says by itself of a fault that comes and goes, and which identifier of a PDO it may show."""

from __future__ import annotations

import pytest

from drivers.cia402 import objects as o
from drivers.frame_array import received_array
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import LEGS, DriveFault, DriveState, Reaction
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.messages import Status
from tests.drivers.cia402_drives import NODES, drives, holding

P = ByValue(drives())
SETUP = DriveSetup(0.05, Reaction.DAMP, 250.0)
CODES = {DriveFault.WATCHDOG: 0x8130}


def told(memory, leg, state, fault=DriveFault.NONE):
    """Return the memory of the drives and the EMCYs of one that reports its state."""
    memory, frames = P.report(memory, Status(leg, state, fault))
    return memory, [frame for frame in frames if frame.id == 0x080 + NODES[leg]]


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_fault_is_told_once_and_once_that_it_is_over_each_time_it_comes(leg):
    memory = holding(P.protocol, [DriveState.RUN] * LEGS)
    for _ in range(2):
        memory, come = told(memory, leg, DriveState.FAULT, DriveFault.WATCHDOG)
        assert [frame.data.hex() for frame in come] == ["3081110000000000"]
        for _ in range(3):
            memory, again = told(memory, leg, DriveState.FAULT, DriveFault.WATCHDOG)
            assert again == []
        memory, gone = told(memory, leg, DriveState.OFF)
        assert [frame.data for frame in gone] == [bytes(8)]
        memory, again = told(memory, leg, DriveState.OFF)
        assert again == []


@pytest.mark.parametrize("leg", range(LEGS))
def test_the_controller_takes_a_fault_that_is_over_for_none(leg):
    last, m = new_record(), new_record()
    last["drive_fault"], m["tick"] = 0x8130, 1
    over = Frame(0x080 + NODES[leg], bytes(8))
    P.decode(P.start(SETUP), received_array([Received(1, over)]), last, m, 0)
    assert m["drive_fault"].tolist() == [0 if each == leg else 0x8130 for each in range(LEGS)]


def shown(protocol, leg, at, value):
    """Return the step that a drive is at which answers the reading of step `at` with a value."""
    index, sub = protocol.plans(SETUP)[leg][at].key
    asked = [3 if each == leg else -1 for each in range(LEGS)]
    dialogue = protocol.start(SETUP)._replace(at=at, asked=asked)
    data = bytes((0x43, index & 0xFF, index >> 8, sub)) + value.to_bytes(4, "little")
    reply = received_array([Received(1, Frame(0x580 + NODES[leg], data))])
    return protocol.decode(dialogue, reply, new_record(), new_record(), 0).at[leg]


@pytest.mark.parametrize("leg", [0, 5])
@pytest.mark.parametrize(("velocity", "on"), [(True, 3), (False, 2)])
def test_a_drive_may_say_that_its_pdo_has_no_remote_frames_and_nothing_else_than_was_written(
    leg, velocity, on
):
    protocol = ByValue(drives(velocity=velocity))
    plan = protocol.plans(SETUP)[leg]
    found = [
        at
        for at, step in enumerate(plan)
        if step.kind == "read" and step.key in ((o.RPDO, 1), (o.TPDO, 1), (o.TPDO + 1, 1))
    ]
    valid = [at for at in found if not plan[at].value & 1 << 31]
    assert len(valid) == on
    for at in found:
        taken = [bit for bit in range(32) if shown(protocol, leg, at, plan[at].value ^ 1 << bit) == at + 1]
        assert shown(protocol, leg, at, plan[at].value) == at + 1
        assert taken == ([30] if at in valid else list(range(31)))
