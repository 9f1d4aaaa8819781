"""When faults are present: at each instant the same ones, in whatever order the instants are asked for."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from plant_fmu.drives import drives_end
from plant_fmu.drives.gateway import Gateway
from plant_fmu.faults.fault import NEVER_NS, Fault, Occurrence, Passage
from plant_fmu.faults.kinds import (
    BusFlood,
    DriveReset,
    DriveSilence,
    EncoderJump,
    EncoderNoise,
    FramesDelay,
    FramesDuplicate,
    FramesLoss,
    FramesOld,
    FramesReorder,
    SenderFault,
)
from plant_fmu.faults.plan import FaultPlan, Schedule

PROTOCOL = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))


MS = 1_000_000
FAULTS = (
    DriveSilence(leg=1, at_s=2e-3, for_s=3e-3),
    DriveReset(leg=2, at_s=3e-3),
    EncoderJump(leg=3, by_m=1e-3, at_s=4e-3),
    DriveSilence(leg=4, mode="TRACKING"),
)
BEGIN_END = ((2 * MS, 5 * MS), (3 * MS, 3 * MS + 1), (4 * MS, NEVER_NS), (NEVER_NS, NEVER_NS))
TIMES = sorted(
    {max(0, edge + by) for ends in BEGIN_END for edge in ends[:2] for by in (-1, 0, 1) if edge < NEVER_NS}
)


def numbers(schedule: Schedule, t_ns: int) -> list[int]:
    return [FAULTS.index(own.fault) for own in schedule.active(t_ns)]


def test_present_faults_do_not_depend_on_earlier_queries():
    schedule = Schedule(FaultPlan(FAULTS), 0)
    for pair in itertools.product(TIMES, TIMES):
        for t_ns in pair:
            expected = [n for n, (begin, end) in enumerate(BEGIN_END) if begin <= t_ns < end]
            assert numbers(schedule, t_ns) == expected, pair


def test_reached_mode_counts_at_once():
    schedule = Schedule(FaultPlan(FAULTS), 0)
    assert numbers(schedule, 9 * MS) == [2]
    assert schedule.reached("TRACKING", 9 * MS)
    assert numbers(schedule, 9 * MS) == [2, 3]


def test_edges_are_unique_and_rising_and_omit_never():
    plan = FaultPlan([*FAULTS, DriveSilence(leg=0), DriveSilence(leg=5, at_s=2e-3, for_s=2e-3)])
    schedule = Schedule(plan, 0)
    edges = [0, 2 * MS, 3 * MS, 3 * MS + 1, 4 * MS, 5 * MS]
    assert schedule.edges_ns(0) == edges
    assert schedule.edges_ns(2 * MS) == edges[1:]
    assert schedule.edges_ns(2 * MS + 1) == edges[2:]
    assert schedule.edges_ns(5 * MS + 1) == []


def test_a_fault_has_begun_at_its_instant_and_waits_only_for_a_mode():
    schedule = Schedule(FaultPlan(FAULTS), 0)
    begun = [[FAULTS.index(fault) for fault in schedule.begun(t_ns)] for t_ns in (2 * MS - 1, 2 * MS, 4 * MS)]
    assert begun == [[], [0], [0, 1, 2]]
    assert schedule.waiting == FAULTS[3:]


def test_foreign_frame_stays_foreign_through_further_faults():
    """One that repeats the last frame, and one that is late."""
    schedule = Schedule(FaultPlan([FramesOld(back=1), FramesDelay(by_ms=1.0)]), 0)
    found = []
    for k in range(3):
        frames = schedule.carry(k * MS, Frame(5, bytes([k])), to_drives=True)
        found.append([(t_ns // MS, frame.data[0], foreign) for t_ns, frame, foreign in frames])
    assert found == [[(1, 0, False)], [(2, 1, False), (2, 0, True)], [(3, 2, False), (3, 1, True)]]


def test_two_senders_count_each_its_own_frames_and_a_late_frame_is_heard_once_at_its_time():
    floods = [BusFlood(rate_Hz=1000.0, identifier=1), BusFlood(rate_Hz=500.0, identifier=2, at_s=1e-3)]
    late = FramesDelay(by_ms=2.0, identifier=9)
    gateway = Gateway(Schedule(FaultPlan([*floods, late]), 0), PROTOCOL, drives_end(PROTOCOL), 0)
    heard: list[tuple[int, int]] = []
    for t_ms in range(6):
        received = [Received(t_ms * MS, Frame(9, b""))] if t_ms == 1 else []
        heard += [(frame.id, t_ns // MS) for t_ns, frame in gateway.hear(received, t_ms * MS)]
    assert [t for identifier, t in heard if identifier == 1] == [0, 1, 2, 3, 4, 5]
    assert [t for identifier, t in heard if identifier == 2] == [1, 3, 5]
    assert [t for identifier, t in heard if identifier == 9] == [3]


def test_plan_defaults_to_seed_0_and_earth_gravity():
    assert FaultPlan().gravity.tolist() == [0.0, 0.0, -9.81]
    draws = []
    for plan in (FaultPlan([FramesLoss(probability=0.5)]), FaultPlan([FramesLoss(probability=0.5)], seed=0)):
        schedule = Schedule(plan, 0)
        draws.append([len(schedule.carry(0, Frame(1, b""), to_drives=True)) for _ in range(64)])
    assert draws[0] == draws[1]
    assert 0 < sum(draws[0]) < 64


def test_each_fault_has_a_random_generator_of_its_own():
    noises = [EncoderNoise(leg=0, sigma_m=1.0), EncoderNoise(leg=0, sigma_m=1.0)]
    schedule = Schedule(FaultPlan([DriveSilence(leg=1, for_s=1e-3), *noises]), 0)
    first, then = ([draw for _, _, draw in schedule.present(t_ns).noise] for t_ns in (0, 2 * MS))
    assert first[0] is not first[1]
    assert all(now is before for now, before in zip(then, first, strict=True))
    assert first[0].random() != first[1].random()


def test_each_fault_remembers_the_frames_that_have_reached_it_and_no_others():
    schedule = Schedule(FaultPlan([FramesOld(back=1), FramesOld(back=1)]), 0)
    found = []
    for k in range(2):
        frames = schedule.carry(0, Frame(5, bytes([k])), to_drives=True)
        found.append([(frame.data[0], foreign) for _, frame, foreign in frames])
    assert found == [[(0, False)], [(1, False), (0, True), (0, True), (1, True)]]


def test_a_frame_that_waits_for_the_next_one_to_the_drives_is_not_freed_by_one_from_them():
    gateway = Gateway(Schedule(FaultPlan([FramesReorder()]), 0), PROTOCOL, drives_end(PROTOCOL), 0)
    frames = [Frame(9, bytes([k])) for k in range(3)]
    assert gateway.hear([Received(0, frames[0])], 0) == []
    assert gateway.send([(0, frames[1])]) == []
    assert gateway.hear([Received(MS, frames[2])], MS) == [Received(MS, frames[2]), Received(MS, frames[0])]
    assert gateway.send([(MS, frames[2])]) == [(MS, frames[2]), (MS, frames[1])]


@pytest.mark.parametrize(
    ("kind", "when_struck"), [(FramesLoss, 0), (FramesDuplicate, 2), (FramesReorder, 0), (FramesOld, 2)]
)
def test_a_frame_is_struck_where_its_draw_is_below_the_probability_and_not_where_it_equals_it(
    kind, when_struck
):
    frame, place = Frame(5, b"x"), (True, 0, 5)
    for draw, count in ((0.25, when_struck), (0.5, 1), (0.75, 1)):
        passed = Occurrence(Fault(), 0, cast("Any", SimpleNamespace(random=lambda draw=draw: draw)))
        passed.frames[place] = [] if kind is FramesReorder else [frame] * 2
        assert len(kind(probability=0.5).carry(0, frame, place, passed)) == count, draw


def test_a_fault_lasts_a_nanosecond_at_least_and_to_the_end_where_nothing_is_said():
    lasting = [(1e-12, 1), (1e-9, 1), (3e-9, 3), (2.0, 2_000_000_000), (None, NEVER_NS)]
    for for_s, lasts_ns in lasting:
        assert DriveSilence(leg=0, for_s=for_s).lasts_ns == lasts_ns
    assert DriveReset(leg=0).lasts_ns == 1


def test_a_kind_of_fault_that_does_not_say_what_it_does_to_frames_concerns_all_and_is_an_error():
    frame, place, passed = Frame(5, b"x"), (True, 0, 5), Occurrence(Fault(), 0, np.random.default_rng(0))
    assert Passage(kind="x").concerns(frame)
    protocol = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
    for use in (
        lambda: Passage(kind="x").carry(0, frame, place, passed),
        lambda: SenderFault(kind="x").frames(protocol, 0),
    ):
        with pytest.raises(NotImplementedError):
            use()


@pytest.mark.parametrize("back", [1, 2, 5])
def test_an_old_frame_is_of_so_many_frames_ago_however_seldom_one_is_sent_again(back):
    schedule = Schedule(FaultPlan([FramesOld(back=back, probability=0.3)]), 0)
    again = []
    for number in range(100):
        _, *old = schedule.carry(number, Frame(0x110, bytes((number,)), 0), to_drives=True)
        again += [(number, frame.data[0]) for _, frame, _ in old]
    assert 15 < len(again) < 45
    assert all(sent == number - back for number, sent in again)
