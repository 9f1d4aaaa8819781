"""localcan channels that share the clock of the first, and a foreign node on the second."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from drivers.can.localcan.participant import Participant
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from tests.drivers.received_frames import got

pytestmark = pytest.mark.usefixtures("runtime")
STOOD_NS = 3_000_000
LONG_NS = 60_000_000_000


class Bench(NamedTuple):
    """Two channels on one clock, and a stranger that has joined the second channel directly."""

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
    """Let bench time stand still for a while, and resume."""
    clock = bench.first.clock
    clock.holds = True
    clock.working(1)
    until = time.monotonic_ns() + STOOD_NS
    while time.monotonic_ns() < until:
        pass
    clock.working(LONG_NS)
    assert clock.stretched() >= STOOD_NS - 1_000


def queued_ns(stranger: Participant) -> int:
    """Send a frame; the result is its time of queueing by the clock of its channel."""
    assert stranger.send(sent_array([Frame(1, b"")])) == 1
    return stranger.sent_ns()[0]


@pytest.mark.parametrize("joins", ["before", "after"])
def test_foreign_node_on_the_second_channel_uses_the_simulated_time_of_the_first(bench, joins):
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


def test_frame_of_a_foreign_sender_on_the_second_channel_ends_pauses_of_simulated_time(bench):
    clock = bench.first.clock
    clock.begin(1, 1)
    clock.holds = True
    assert bench.second.send(sent_array([Frame(2, b"")])) == 1
    got(bench.stranger.receive())
    clock.working()
    assert not clock.interrupted, "so far the foreign node has only listened"
    queued_ns(bench.stranger)
    clock.working()
    assert clock.interrupted
