"""Rules on encoders for drives whose answers do not identify their SYNC or poll."""

from __future__ import annotations

import pytest

from drivers.signals import Doubt
from tests.hil.encoder_bench import BOTH_SIGNS, CREEP, RATES, T, after, calm, doubted, six


def after_a_miss(ticks, ways, unnamed=1, apart=0):
    """Record of a tick in which leg 5 is off by its motion in `ways` periods, after a miss of all legs."""
    bench = after(60, rate=RATES, unnamed=unnamed, apart=apart)
    bench.tick(unseen=range(6))
    if ticks:
        bench.ticks(ticks)
    return bench.tick(jump=six(ways * RATES[5] * T, 5))


@BOTH_SIGNS
@pytest.mark.parametrize(
    ("ticks", "unnamed", "apart"), [(0, 1, 0), (7, 1, 0), (7, 1, 1), (8, 1, 0), (8, 1, 1), (0, 0, 0)]
)
def test_encoders_accept_answers_to_the_last_poll_for_eight_ticks_after_a_miss(ticks, unnamed, apart, sign):
    assert calm(after_a_miss(ticks, 0.95 * sign, unnamed, apart)) == (ticks < 8 and unnamed)
    found = after_a_miss(ticks, 1.2 * sign, unnamed, apart)
    assert (found["doubt"], found["legs_doubted"]) == (Doubt.JUMP, 1 << 5)


def test_encoders_allow_the_noise_of_two_periods_for_an_answer_to_an_older_poll():
    bench = after(3, unnamed=1, rate_noise_m_s=1.0)
    bench.tick(unseen=range(6))
    bench.ticks(1)
    assert doubted(bench.tick(jump=six(2.5 * T, 1)), Doubt.JUMP, 1, 2.5 * T, 2.0 * T + 2.0 * CREEP)


@pytest.mark.parametrize(("ticks", "doubt"), [(8, Doubt.NONE), (9, Doubt.LEAP)])
def test_encoders_check_a_rate_jump_only_after_readings_of_known_spacing(ticks, doubt):
    bench = after(60, rate=RATES, unnamed=1, open_ticks=0, length_noise_m=1.0)
    bench.tick(unseen=range(6))
    bench.ticks(ticks)
    assert bench.tick(rate=RATES + six(3.0, 2))["doubt"] == doubt


@pytest.mark.parametrize(("leg", "apart", "doubts"), [(0, 1, True), (0, 0, False), (5, 1, False)])
def test_encoders_widen_only_the_bounds_of_a_missed_drive_that_samples_by_itself(leg, apart, doubts):
    bench = after(60, rate=RATES, unnamed=1, apart=apart)
    for _ in range(3):
        bench.ticks(1, unseen=[5])
        bench.ticks(1)
    found = bench.tick(jump=six(0.95 * RATES[leg] * T, leg))
    assert (found["doubt"], found["legs_doubted"]) == ((Doubt.JUMP, 1 << leg) if doubts else (Doubt.NONE, 0))


@pytest.mark.parametrize(("way", "doubts"), [(0.95, False), (2.5, True)])
def test_encoders_accept_an_answer_to_an_older_poll_of_a_missed_leg_in_a_late_tick(way, doubts):
    bench = after(60, rate=RATES, unnamed=1, apart=1)
    bench.ticks(1, unseen=[5])
    bench.ticks(1)
    found = bench.tick(late_s=0.5 * T, jump=six(way * RATES[5] * T, 5))
    assert (found["doubt"], found["legs_doubted"]) == ((Doubt.JUMP, 1 << 5) if doubts else (Doubt.NONE, 0))


@pytest.mark.parametrize(
    ("unnamed", "apart", "leg", "doubts"),
    [(1, 1, 2, True), (1, 1, 0, False), (1, 0, 2, False), (0, 0, 2, True)],
)
def test_encoders_do_not_check_rates_after_readings_of_unknown_spacing(unnamed, apart, leg, doubts):
    """Rates of drives that latch separately are judged next to a missed one."""
    bench = after(60, rate=RATES, unnamed=unnamed, apart=apart, open_ticks=0, length_noise_m=1.0)
    bench.ticks(1, unseen=[0])
    found = bench.tick(rate=RATES + six(3.0, leg))
    assert found["doubt"] == (Doubt.LEAP if doubts else Doubt.NONE)
