"""When the drives latched: by the bus, and by the answers where the clock was read too late."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.protocol import BUS, DriveSetup, Frame, Received
from drivers.signals import Reaction
from drivers.tick_columns import row_of
from hil.app.compose import build_cycle
from hil.app.configuration.bus_budget import shortest_answer_ns
from hil.app.configuration.configuration import load
from hil.loop.latches import checked, latch_ns
from hil.loop.replay import recorded_input
from hil.record.log import Tick
from hil.signals import TickInput
from tests.records import record_of

SYNC, ANSWER = Frame(0x80, b""), 135_000
"""ns of a TPDO of 8 bytes at 1 Mbit/s."""
CIA = load("virtual-cia402")
TPDO = [Frame(0x181 + leg, b"\x50\x02" + bytes(6)) for leg in range(6)]


def protocol(name):
    c = load(name)
    return build_protocol(c.bus, c.drives)


def test_one_sync_is_that_of_all_legs():
    assert latch_ns(protocol("virtual-cia402"), [SYNC], [1_500], 1_000) == (500,) * 6


def test_each_bus_has_its_own_sync():
    opening = [SYNC, Frame(0x80, b"", BUS)]
    found = latch_ns(protocol("two_buses"), opening, [1_500, 3_500], 1_000)
    assert found == (500, 500, 500, 2_500, 2_500, 2_500)


def test_each_poll_is_that_of_its_leg():
    family = protocol("desktop")
    polls = family.begin(family.start(DriveSetup(0.01, Reaction.BRAKE, 400.0)), 0)
    assert latch_ns(family, polls, [1_001, 1_002, 1_003, 1_004, 1_005, 1_006], 1_000) == (1, 2, 3, 4, 5, 6)


def test_what_the_bus_did_not_take_counts_as_of_the_wake_up():
    opening = [SYNC, Frame(0x80, b"", BUS)]
    two = protocol("two_buses")
    assert latch_ns(two, opening, [None, 1_500], 1_000) == (0, 0, 0, 500, 500, 500)
    assert latch_ns(two, opening, [1_500], 1_000) == (500, 500, 500, 0, 0, 0)


@pytest.mark.parametrize("first", [0, 3, 5])
def test_a_clock_that_was_read_late_is_set_right_by_the_first_answer(first):
    """SYNC is written at 1 ms; a stall of 1.5 ms before the clock is read."""
    answers = [
        Received(1_000_000 + 190_000 + 135_000 * n, TPDO[leg])
        for n, leg in enumerate(np.roll(range(6), -first))
    ]
    found = checked(protocol("virtual-cia402"), [SYNC], [2_500_000], answers, 1_000_000, 2_500_000, ANSWER)
    assert found == [1_055_000]


def test_nothing_but_younger_feedback_of_the_same_bus_sets_a_clock_right():
    family, late_ns = protocol("virtual-cia402"), 2_500_000
    wrong = [
        Received(1_134_999, TPDO[0]),  # on the wire before SYNC was given to the bus
        Received(1_200_000, Frame(0x701, b"\x05")),
        Received(3_000_000, TPDO[1]),  # later than the clock says, too
    ]
    assert checked(family, [SYNC], [late_ns], wrong, 1_000_000, late_ns, ANSWER) == [late_ns]
    two = protocol("two_buses")
    other = [Received(1_200_000, Frame(0x281, bytes(12), 6))]
    opening = [SYNC, Frame(0x80, b"", BUS)]
    assert checked(two, opening, [1_010_000, late_ns], other, 1_000_000, late_ns, ANSWER) == [
        1_010_000,
        late_ns,
    ]
    assert checked(two, opening, [late_ns, None], other, 1_000_000, late_ns, ANSWER) == [1_065_000, None]


def test_a_prompt_send_is_not_held_against_its_answers():
    answers = [Received(1_000_000 + ANSWER, TPDO[0])]
    assert checked(
        protocol("virtual-cia402"), [SYNC], [1_099_999], answers, 1_000_000, 1_099_999, ANSWER
    ) == [1_099_999]


def test_the_shortest_answer_is_that_of_the_feedback_on_the_fastest_bus():
    assert shortest_answer_ns(CIA.bus, protocol("virtual-cia402")) == ANSWER
    two = load("two_buses")
    assert shortest_answer_ns(two.bus, protocol("two_buses")) == 64_600


def test_the_pose_is_estimated_as_of_the_first_latch(monkeypatch):
    cycle, seen = build_cycle(load("virtual"), 1000.0, 0.013), []
    monkeypatch.setattr(cycle.sight, "estimate", lambda _tick, _last, latched_ns: seen.append(latched_ns))
    cycle.step(TickInput(0, 1_000, 20, latch_ns=(7, 9, 5, 6, 8, 5)))
    assert seen == [1_025]


def test_a_replay_is_given_the_latch_of_every_leg():
    row: Any = row_of(
        record_of(tick=4, t_ns=7, compute_ns=5, recorder_alive=1, latch_ns=[11, 12, 13, 14, 15, 16])
    )
    inp = recorded_input(Tick(row, (), (), ()))
    assert (inp.latch_ns, inp.compute_ns, inp.tick) == ((11, 12, 13, 14, 15, 16), 5, 4)
