"""Sampling instants of the drives: from the bus, and from the answers after a late clock reading."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.frame_array import received_array, sent_array
from drivers.protocol import BUS, Frame, Received
from hil.app.configuration.bus_budget import shortest_answer_ns
from hil.app.configuration.configuration import load
from hil.contracts.drives_end import reading_of
from hil.contracts.messages import Sync, hear, reply
from hil.loop import latch_times
from plant_fmu.drives import drives_end
from tests.drivers.legs_frames import opening


def latch_ns(family, opening, sent_ns, woke_ns):
    return latch_times.latch_ns(family, sent_array(opening), sent_ns, woke_ns)


def checked(family, opening, sent_ns, answers, *times):
    return latch_times.checked(family, sent_array(opening), sent_ns, received_array(answers), *times)


SYNC, ANSWER = Frame(0x80, b""), 111_000
"""Duration in ns of a TPDO of 8 bytes at 1 Mbit/s without stuff bits, and of the three bits before it."""
TPDO = [Frame(0x181 + leg, b"\x50\x02" + bytes(6)) for leg in range(6)]


def protocol(name):
    c = load(name)
    return build_protocol(c.bus, c.drives)


@pytest.mark.parametrize(
    ("name", "sent_ns", "latches"),
    [
        ("virtual-cia402", [1_500], (500,) * 6),
        ("two_buses", [1_500, 3_500], (500, 500, 500, 2_500, 2_500, 2_500)),
        ("two_buses", [None, 1_500], (0, 0, 0, 500, 500, 500)),  # what the bus did not take: the wake-up
        ("two_buses", [1_500], (500, 500, 500, 0, 0, 0)),
        ("desktop", [1_001, 1_002, 1_003, 1_004, 1_005, 1_006], (1, 2, 3, 4, 5, 6)),
    ],
)
def test_sampling_instant_of_a_leg_is_the_sync_of_its_bus_or_its_own_poll(name, sent_ns, latches):
    family = protocol(name)
    syncs = {"virtual-cia402": [SYNC], "two_buses": [SYNC, Frame(0x80, b"", BUS)]}
    assert latch_ns(family, syncs.get(name) or opening(family, 0), sent_ns, 1_000) == latches


@pytest.mark.parametrize("first", [0, 3, 5])
def test_sampling_instant_is_corrected_by_the_first_answer_after_a_late_clock_reading(first):
    """SYNC is written at 1 ms; the clock is read after a stall of 1.5 ms."""
    answers = [
        Received(1_000_000 + 190_000 + 135_000 * n, TPDO[leg])
        for n, leg in enumerate(np.roll(range(6), -first))
    ]
    found = checked(protocol("virtual-cia402"), [SYNC], [2_500_000], answers, 0, 1_000_000, 2_500_000, ANSWER)
    assert found == [1_079_000]


def test_sampling_instant_is_corrected_only_by_newer_feedback_of_the_same_bus():
    family, late_ns = protocol("virtual-cia402"), 2_500_000
    wrong = [
        Received(1_110_999, TPDO[0]),  # on the wire before SYNC was given to the bus
        Received(1_200_000, Frame(0x701, b"\x05")),
        Received(3_000_000, TPDO[1]),  # later than the clock says, too
    ]
    assert checked(family, [SYNC], [late_ns], wrong, 0, 1_000_000, late_ns, ANSWER) == [late_ns]
    two = protocol("two_buses")
    other = [answer_of_two(0)]
    opening = [SYNC, Frame(0x80, b"", BUS)]
    assert checked(two, opening, [1_010_000, late_ns], other, 0, 1_000_000, late_ns, ANSWER) == [
        1_010_000,
        late_ns,
    ]
    assert checked(two, opening, [late_ns, None], other, 0, 1_000_000, late_ns, ANSWER) == [1_089_000, None]
    assert checked(two, opening, [late_ns], other, 0, 1_000_000, late_ns, ANSWER) == [1_089_000]


def answer_of_two(tick):
    """Feedback of leg 0 to the SYNC of a tick, 0.2 ms after the SYNC was given to the bus."""
    two = protocol("two_buses")
    end = drives_end(two)
    (sync,) = hear(end, opening(two, tick)[0])
    assert isinstance(sync, Sync)
    zeros, states = np.zeros(6), np.zeros(6, dtype=np.int64)
    return Received(1_200_000, dict(reply(end, sync, reading_of(zeros, zeros, zeros, states)))[0])


def test_sampling_instant_is_not_corrected_by_an_answer_to_an_older_sync_or_a_damaged_one():
    """After a stall of 1.5 ms before SYNC, the pending answer of a drive arrives."""
    two, late_ns, opening = protocol("two_buses"), 2_500_000, [SYNC, Frame(0x80, b"", BUS)]
    for tick, answer, expected in [
        (5, answer_of_two(5), 1_089_000),
        (5, answer_of_two(4), late_ns),
        (5, flipped(answer_of_two(5)), late_ns),
    ]:
        found = checked(two, opening, [late_ns, late_ns], [answer], tick, 1_000_000, late_ns, ANSWER)
        assert found == [expected, late_ns]
    short = [Received(1_200_000, Frame(0x181, bytes(7)))]
    assert checked(protocol("virtual-cia402"), [SYNC], [late_ns], short, 0, 1_000_000, late_ns, ANSWER) == [
        late_ns
    ]


def flipped(answer):
    """Answer with one flipped bit in its last byte."""
    t_ns, (identifier, data, flags) = answer
    return Received(t_ns, Frame(identifier, data[:-1] + bytes((data[-1] ^ 1,)), flags))


@pytest.mark.parametrize("given_ns", [1_000_090, 1_000_900])
def test_answer_on_virtual_can_may_arrive_before_the_clock_is_read(given_ns):
    """Such an answer must not count as one to an older SYNC, which would make its leg stale."""
    answers = [Received(1_000_050 + leg, TPDO[leg]) for leg in range(6)]
    found = checked(protocol("virtual-cia402"), [SYNC], [given_ns], answers, 0, 1_000_000, given_ns, 0)
    assert found == [1_000_050]


@pytest.mark.parametrize(("given_ns", "answer_ns"), [(1_100_000, ANSWER), (1_050_000, 50_000)])
def test_sampling_instant_after_a_slow_send_is_corrected_by_the_answers(given_ns, answer_ns):
    answers = [Received(1_000_000 + answer_ns, TPDO[0])]
    late, prompt = (
        checked(protocol("virtual-cia402"), [SYNC], [sent_ns], answers, 0, 1_000_000, sent_ns, answer_ns)
        for sent_ns in (given_ns, given_ns - 1)
    )
    assert (late, prompt) == ([1_000_000], [given_ns - 1])


class Plain:
    """Family with leg numbers as identifiers; every later frame may be an answer."""

    def __init__(self, unasked_s: float) -> None:
        self.traits = SimpleNamespace(unasked_s=unasked_s, feedback_ids=frozenset())

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        return (frame.id,)

    def sender(self, frame: Frame) -> int:
        return frame.id

    def fresh(self, answer: Received, _tick: int, since_ns: int) -> bool:
        return answer.t_ns >= since_ns


@pytest.mark.parametrize(("unasked_s", "expected"), [(0.0, [1_300, 1_200]), (0.01, [1_700, 1_200])])
def test_only_the_last_answer_counts_of_a_drive_with_unrequested_frames(unasked_s, expected):
    """A feedback frame takes 200 ns."""
    family: Any = Plain(unasked_s)
    polls = [Frame(4, b""), Frame(5, b"")]
    answers = [Received(t_ns, Frame(leg, b"")) for t_ns, leg in ((1_500, 4), (1_400, 5), (1_900, 4))]
    assert checked(family, polls, [9_000, 9_000], answers, 0, 1_000, 9_000, 200) == expected


@pytest.mark.parametrize(("name", "answer_ns"), [("virtual-cia402", ANSWER), ("two_buses", 54_800)])
def test_shortest_answer_is_unstuffed_feedback_on_the_fastest_bus(name, answer_ns):
    assert shortest_answer_ns(load(name).bus, protocol(name)) == answer_ns
