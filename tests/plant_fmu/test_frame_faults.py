"""Effects of faults on frames: by identifier, bus and direction, with seeded random numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from drivers.config import MAX_BUSES
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BUS, Frame
from plant_fmu.drives import drives_end
from plant_fmu.drives.gateway import Gateway
from plant_fmu.faults import kinds
from plant_fmu.faults.plan import FaultPlan, Schedule

MS, S = 1_000_000, 1_000_000_000
FRAME = Frame(0x282, bytes(range(12)), 6)
PROTOCOL = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))


def carry(schedule: Schedule, t_ns: int, frame: Frame = FRAME, *, to_drives: bool = True) -> list[Any]:
    return schedule.carry(t_ns, frame, to_drives=to_drives)


@pytest.mark.parametrize(
    "kind", [kinds.FramesLoss, kinds.FramesDuplicate, kinds.FramesReorder, kinds.FramesDelay]
)
@pytest.mark.parametrize("identifier", [0, 0x80, 0x7FF])
def test_frame_fault_affects_the_given_identifier_during_the_given_time(kind, identifier):
    more = {"by_ms": 1.0} if kind is kinds.FramesDelay else {}
    fault = kind(identifier=identifier, at_s=1.0, for_s=1.0, **more)
    frames = [Frame(each, b"x", BUS * k) for each in (0, 0x80, 0x7FF) for k in (0, 1)]
    for t_ns, struck in ((S - 1, False), (S, True), (2 * S - 1, True), (2 * S, False)):
        schedule = Schedule(FaultPlan([kinds.DriveSilence(leg=0), fault]), 0)
        passed = [f for f in frames if carry(schedule, t_ns, f) == [(t_ns, f, False)]]
        assert passed == [f for f in frames if not struck or f.id != identifier]


@pytest.mark.parametrize("to_drives", [True, False])
@pytest.mark.parametrize("bus", [None, *range(MAX_BUSES)])
def test_bus_off_fault_cuts_the_given_bus_or_all_buses_in_both_directions(bus, to_drives):
    schedule = Schedule(FaultPlan([kinds.BusOff(bus=bus, at_s=1.0, for_s=1.0)]), 0)
    frames = [Frame(0x80, b"", BUS * k) for k in range(MAX_BUSES)]
    for t_ns, cut in ((S, True), (2 * S, False)):
        passed = [f for f in frames if carry(schedule, t_ns, f, to_drives=to_drives)]
        assert passed == [f for f in frames if not cut or bus not in (None, f.bus)]
    assert schedule.present(S).bus_off == ((1 << MAX_BUSES) - 1 if bus is None else 1 << bus)


@pytest.mark.parametrize("kind", [kinds.FramesLoss, kinds.FramesDuplicate])
def test_random_frame_faults_have_the_given_probability_and_repeat_with_the_seed(kind):
    def struck(seed: int, of_plan: int = 7) -> list[bool]:
        schedule = Schedule(FaultPlan([kind(probability=0.1, seed=seed)], seed=of_plan), 0)
        return [len(carry(schedule, 0)) != 1 for _ in range(10_000)]

    first = struck(3)
    assert first == struck(3)
    assert first != struck(4)
    assert first != struck(3, of_plan=8)
    assert abs(sum(first) - 1000) < 5 * (10_000 * 0.1 * 0.9) ** 0.5  # five standard deviations


def test_two_random_frame_faults_with_the_same_seed_are_independent():
    schedule = Schedule(FaultPlan([kinds.FramesLoss(probability=0.5), kinds.FramesLoss(probability=0.5)]), 0)
    passed = sum(len(carry(schedule, 0)) for _ in range(10_000))
    assert abs(passed - 2500) < 5 * (10_000 * 0.25 * 0.75) ** 0.5


def test_frame_corruption_fault_flips_one_bit_and_does_not_change_empty_frames():
    schedule = Schedule(FaultPlan([kinds.FramesCorrupt()]), 0)
    places = set()
    for _ in range(2000):
        ((_, frame, foreign),) = carry(schedule, 0)
        assert not foreign
        assert (frame.id, frame.flags) == (FRAME.id, FRAME.flags)
        change = int.from_bytes(frame.data, "big") ^ int.from_bytes(FRAME.data, "big")
        assert change.bit_count() == 1
        places.add(change)
    assert len(places) == 96
    empty = Frame(1, b"")
    assert carry(schedule, 0, empty) == [(0, empty, False)]


def on_buses(schedule: Schedule, buses: Sequence[int], *, to_drives: bool) -> list[tuple[int, int]]:
    """Pass numbered frames of one identifier, one per ms, on the given buses; return those that arrive."""
    found = []
    for k, bus in enumerate(buses):
        arriving = carry(schedule, k * MS, Frame(0x80, bytes([k]), BUS * bus), to_drives=to_drives)
        found += [(frame.bus, frame.data[0]) for _, frame, _ in arriving]
    return found


@pytest.mark.parametrize("to_drives", [True, False])
def test_frame_reordering_fault_swaps_frames_of_the_same_bus(to_drives: bool):
    schedule = Schedule(FaultPlan([kinds.FramesReorder()]), 0)
    found = on_buses(schedule, (0, 1, 1, 0), to_drives=to_drives)
    assert found == [(1, 2), (1, 1), (0, 3), (0, 0)]


@pytest.mark.parametrize("to_drives", [True, False])
def test_frame_repetition_fault_repeats_an_old_frame_on_the_bus_of_that_frame(to_drives: bool):
    schedule = Schedule(FaultPlan([kinds.FramesOld(back=1)]), 0)
    found = on_buses(schedule, (0, 1, 0, 1), to_drives=to_drives)
    assert found == [(0, 0), (1, 1), (0, 2), (0, 0), (1, 3), (1, 1)]


@pytest.mark.parametrize("back", [1, 2, 5])
def test_frame_repetition_fault_repeats_the_frame_sent_the_given_number_of_frames_ago(back):
    schedule = Schedule(FaultPlan([kinds.FramesOld(back=back, probability=0.3)]), 0)
    again = []
    for number in range(100):
        present, *old = schedule.carry(number, Frame(0x110, bytes((number,)), 0), to_drives=True)
        assert (present[1].data[0], present[2]) == (number, False)
        assert all(foreign for _, _, foreign in old)
        again += [(number, frame.data[0]) for _, frame, _ in old]
    assert 15 < len(again) < 45
    assert all(sent == number - back for number, sent in again)


def test_bus_flood_fault_wins_arbitration_against_all_frames_of_the_protocol():
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
    (there,) = kinds.BusFlood(identifier=0x123, bus=2).frames(protocol, 7)
    assert (there.id, there.data, there.bus) == (0x123, bytes(8), 2)
    (frame,) = kinds.BusFlood().frames(protocol, 0)
    assert frame.id < min(f.id for f in (*protocol.traits.cyclic_frames, *protocol.traits.emergency_stop))
    assert not frame.flags


@pytest.mark.parametrize("bus", range(6))
def test_frames_of_an_injected_bus_flood_or_second_controller_are_on_the_given_bus(bus):
    each_leg = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 60_000.0, [[leg] for leg in range(6)])
    for fault in (kinds.BusFlood(bus=bus), kinds.BusSecondController(bus=bus)):
        assert {frame.bus for frame in fault.frames(each_leg, 3)} == {bus}


@pytest.mark.parametrize("t0_ms", [0, 1, 3_600_000])
def test_frames_of_the_extra_node_of_a_bus_flood_fault_are_queued_at_most_2_ms_ahead(t0_ms):
    t0_ns = t0_ms * MS
    schedule = Schedule(FaultPlan([kinds.BusFlood(rate_Hz=2000.0, for_s=0.012)]), t0_ns)
    gateway = Gateway(schedule, PROTOCOL, drives_end(PROTOCOL), t0_ns)
    sent, heard = [], []
    for until_ms in (0.0, 1.0, 1.5, 1.5, 6.5, 8.0, 20.0, 21.0):
        until_ns = t0_ns + round(until_ms * MS)
        heard.append([(each.t_ns - t0_ns) / MS for each in gateway.hear([], until_ns)])
        sent.append([(t_ns - t0_ns) / MS for t_ns, _ in gateway.send([])])
    halves = [0.5 * k for k in range(24)]
    assert sent == [halves[:1], halves[1:5], [], [], halves[5:18], halves[18:20], halves[20:], []]
    assert heard == [halves[:1], halves[1:3], halves[3:4], [], halves[4:14], halves[14:17], halves[17:], []]
