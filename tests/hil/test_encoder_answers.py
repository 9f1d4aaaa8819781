"""The rules on encoders where an answer does not say which SYNC or poll it answers."""

from __future__ import annotations

import pytest

from drivers.signals import Doubt
from tests.hil.encoder_bench import BOTH_SIGNS, CREEP, RATES, T, after, calm, doubted, six


def after_a_miss(ticks, ways, unnamed=1, apart=0):
    """Return the record of a tick in which leg 5 reads as it was so many periods off; all legs were missed."""
    bench = after(60, rate=RATES, unnamed=unnamed, apart=apart)
    bench.tick(unseen=range(6))
    if ticks:
        bench.ticks(ticks)
    return bench.tick(jump=six(ways * RATES[5] * T, 5))


@BOTH_SIGNS
@pytest.mark.parametrize(
    ("ticks", "unnamed", "apart"), [(0, 1, 0), (7, 1, 0), (7, 1, 1), (8, 1, 0), (8, 1, 1), (0, 0, 0)]
)
def test_encoders_for_eight_ticks_after_a_miss_a_leg_may_answer_the_poll_before(ticks, unnamed, apart, sign):
    assert calm(after_a_miss(ticks, 0.95 * sign, unnamed, apart)) == (ticks < 8 and unnamed)
    found = after_a_miss(ticks, 1.2 * sign, unnamed, apart)
    assert (found["doubt"], found["legs_doubted"]) == (Doubt.JUMP, 1 << 5)


def test_encoders_an_answer_to_the_poll_before_has_the_noise_of_its_longer_time():
    bench = after(3, unnamed=1, rate_noise_m_s=1.0)
    bench.tick(unseen=range(6))
    bench.ticks(1)
    assert doubted(bench.tick(jump=six(2.5 * T, 1)), Doubt.JUMP, 1, 2.5 * T, 2.0 * T + 2.0 * CREEP)


@pytest.mark.parametrize(("ticks", "doubt"), [(8, Doubt.NONE), (9, Doubt.LEAP)])
def test_encoders_a_leap_needs_a_spacing_before_it_that_is_sure(ticks, doubt):
    bench = after(60, rate=RATES, unnamed=1, open_ticks=0, length_noise_m=1.0)
    bench.tick(unseen=range(6))
    bench.ticks(ticks)
    assert bench.tick(rate=RATES + six(3.0, 2))["doubt"] == doubt


@pytest.mark.parametrize(("leg", "apart", "doubts"), [(0, 1, True), (0, 0, False), (5, 1, False)])
def test_encoders_a_drive_that_latches_apart_and_is_missed_widens_its_own_bounds_alone(leg, apart, doubts):
    bench = after(60, rate=RATES, unnamed=1, apart=apart)
    for _ in range(3):
        bench.ticks(1, unseen=[5])
        bench.ticks(1)
    found = bench.tick(jump=six(0.95 * RATES[leg] * T, leg))
    assert (found["doubt"], found["legs_doubted"]) == ((Doubt.JUMP, 1 << leg) if doubts else (Doubt.NONE, 0))


@pytest.mark.parametrize(("way", "doubts"), [(0.95, False), (2.5, True)])
def test_encoders_a_leg_that_was_missed_may_answer_the_poll_before_next_to_a_delay(way, doubts):
    bench = after(60, rate=RATES, unnamed=1, apart=1)
    bench.ticks(1, unseen=[5])
    bench.ticks(1)
    found = bench.tick(late_s=0.5 * T, jump=six(way * RATES[5] * T, 5))
    assert (found["doubt"], found["legs_doubted"]) == ((Doubt.JUMP, 1 << 5) if doubts else (Doubt.NONE, 0))


@pytest.mark.parametrize(
    ("unnamed", "apart", "leg", "doubts"),
    [(1, 1, 2, True), (1, 1, 0, False), (1, 0, 2, False), (0, 0, 2, True)],
)
def test_encoders_no_rate_is_judged_by_a_spacing_that_nobody_knows(unnamed, apart, leg, doubts):
    """Beside one that was missed, rates of drives that latch apart are judged."""
    bench = after(60, rate=RATES, unnamed=unnamed, apart=apart, open_ticks=0, length_noise_m=1.0)
    bench.ticks(1, unseen=[0])
    found = bench.tick(rate=RATES + six(3.0, leg))
    assert found["doubt"] == (Doubt.LEAP if doubts else Doubt.NONE)
