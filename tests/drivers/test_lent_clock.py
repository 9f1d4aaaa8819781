"""Channels of localcan that go by the clock of the first: what a stranger on another one of them makes of it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from drivers.can.localcan.layout import CLOCK_AT, OFFSET_AT, QUEUED, SLOT_COUNT, record_at, slot_at
from drivers.can.localcan.participant import Participant
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from tests.drivers.frames_heard import got

pytestmark = pytest.mark.usefixtures("runtime")
STOOD_NS = 3_000_000
LONG_NS = 60_000_000_000


class Bench(NamedTuple):
    """Two channels on one clock, and a stranger who has joined the second one by himself."""

    first: Participant
    second: Participant
    stranger: Participant


@pytest.fixture
def bench() -> Iterator[Bench]:
    first = Participant("a")
    second = Participant("b", clock=first.clock)
    made = Bench(first, second, Participant("b"))
    yield made
    for each in made:
        each.close()


def stand(bench: Bench) -> None:
    """Let bench time stand still for a while, and go on."""
    clock = bench.first.clock
    clock.holds = True
    clock.working(1)
    until = time.monotonic_ns() + STOOD_NS
    while time.monotonic_ns() < until:
        pass
    clock.working(LONG_NS)
    assert clock.stretched() >= STOOD_NS - 1_000


def queued_ns(stranger: Participant) -> int:
    """Send a frame; return when it is queued, by the time of its channel."""
    number = int(stranger._wire.words[slot_at(stranger.serial) + SLOT_COUNT])
    assert stranger.send(sent_array([Frame(1, b"")])) == 1
    return int(stranger._wire.words[record_at(stranger.serial, number) + QUEUED])


@pytest.mark.parametrize("joins", ["before", "after"])
def test_a_frame_of_a_stranger_on_the_second_channel_does_not_lie_ahead_by_all_that_time_has_stood_still(
    bench, joins
):
    clock = bench.first.clock
    clock.begin(1, 1)
    for _ in range(2):
        stand(bench)
    stranger = bench.stranger if joins == "before" else Participant("b")
    before = clock.now()
    queued = queued_ns(stranger)
    assert before <= queued <= clock.now()
    if stranger is not bench.stranger:
        stranger.close()


def test_a_stranger_who_sends_on_the_second_channel_ends_the_standing_of_time_as_on_the_first(bench):
    clock = bench.first.clock
    clock.begin(1, 1)
    clock.holds = True
    assert bench.second.send(sent_array([Frame(2, b"")])) == 1
    got(bench.stranger.receive())
    clock.working()
    assert not clock.interrupted, "so far he has only looked on"
    queued_ns(bench.stranger)
    clock.working()
    assert clock.interrupted


@pytest.mark.parametrize("says", ["waiting", "leave"])
def test_whatever_lets_time_go_on_again_the_second_channel_lags_by_as_much(bench, says):
    clock = bench.first.clock
    clock.begin(1, 1)
    stand(bench)
    clock.working(1)
    until = time.monotonic_ns() + STOOD_NS
    while time.monotonic_ns() < until:
        pass
    if says == "waiting":
        clock.waiting(clock.now() + LONG_NS)
    else:
        clock.leave()
    assert clock.stretched() >= 2 * STOOD_NS - 2_000
    assert bench.second._wire.words[OFFSET_AT] == clock.stretched()


def test_a_run_begins_anew_whatever_the_one_before_has_left_on_the_second_channel(bench):
    words, clock = bench.second._wire.words, bench.first.clock
    clock.begin(1, 1)
    stand(bench)
    queued_ns(bench.stranger)
    clock.working()
    assert clock.interrupted
    words[OFFSET_AT] += 5 * STOOD_NS
    clock.begin(1, 1)
    clock.working()
    assert not clock.interrupted
    assert words[OFFSET_AT] == clock.stretched()
    assert words[CLOCK_AT] == bench.first._wire.words[CLOCK_AT]


def test_a_channel_that_stays_is_kept_to_the_clock_that_another_one_has_left(bench):
    third = Participant("c", clock=bench.first.clock)
    bench.first.clock.begin(1, 1)
    bench.second.close()
    stand(bench)
    stretched = bench.first.clock.stretched()
    assert third._wire.words[OFFSET_AT] == stretched
    third.close()
