"""A fault of one bus or of one identifier strikes that one alone, the first one and identifier 0 included."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.config import MAX_BUSES
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BUS, Frame
from plant_fmu.faults.fault import Fault, LastingFault, Occurrence
from plant_fmu.faults.kinds import (
    BusFlood,
    BusOff,
    BusSecondController,
    FramesDelay,
    FramesDuplicate,
    FramesLoss,
    FramesReorder,
)
from plant_fmu.faults.plan import FaultPlan, Schedule

BUSES = range(MAX_BUSES)


def untouched(fault: Fault, frames: list[Frame]) -> list[Frame]:
    """Return the frames that arrive at once, each as it is and once."""
    schedule = Schedule(FaultPlan((fault,)), 0)
    return [f for f in frames if schedule.carry(7, f, to_drives=True) == [(7, f, False)]]


@pytest.mark.parametrize("bus", BUSES)
def test_of_several_buses_the_one_that_is_named_is_cut_and_no_other(bus):
    frames = [Frame(0x80, b"", BUS * k) for k in BUSES]
    assert untouched(BusOff(bus=bus), frames) == [f for f in frames if f.bus != bus]
    assert untouched(BusOff(), frames) == []
    for fault, bits in ((BusOff(bus=bus), 1 << bus), (BusOff(), (1 << MAX_BUSES) - 1)):
        assert Schedule(FaultPlan((fault,)), 0).present(0).bus_off == bits


@pytest.mark.parametrize("kind", [FramesLoss, FramesDuplicate, FramesReorder, FramesDelay])
@pytest.mark.parametrize("identifier", [0, 0x80, 0x7FF])
def test_frames_of_the_identifier_that_is_named_are_struck_and_no_others(kind, identifier):
    more = {"by_ms": 1.0} if kind is FramesDelay else {}
    frames = [Frame(each, b"x", BUS * k) for each in (0, 0x80, 0x7FF) for k in (0, 1)]
    found = untouched(kind(identifier=identifier, **more), frames)
    assert found == [f for f in frames if f.id != identifier]


@pytest.mark.parametrize("bus", BUSES)
def test_a_node_that_should_not_be_there_sends_on_the_bus_that_is_named(bus):
    each_leg = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 60_000.0, [[leg] for leg in range(6)])
    for fault in (BusFlood(bus=bus), BusSecondController(bus=bus)):
        sent = fault.frames(each_leg, 3)
        assert sent
        assert {frame.bus for frame in sent} == {bus}


def test_a_fault_that_lasts_less_than_a_nanosecond_is_there_for_one():
    class Short(LastingFault):
        kind: str = "short"

    fault = Short(at_s=1e-9, for_s=1e-10)
    schedule = Schedule(FaultPlan((fault,)), 0)
    assert [bool(schedule.active(t)) for t in range(4)] == [False, True, False, False]


def test_held_frame_comes_once_after_the_next_one():
    fault = FramesReorder()
    own = Occurrence(fault, 0, np.random.default_rng(1))
    first, second, third = (Frame(0x80, bytes((k,))) for k in range(3))
    place = (True, 0, 0x80)
    assert fault.carry(1, first, place, own) == []
    assert fault.carry(2, second, place, own) == [(2, second), (2, first)]
    assert fault.carry(3, third, place, own) == [], "the next one is held back anew"
    assert fault.carry(4, first, place, own) == [(4, first), (4, third)]
