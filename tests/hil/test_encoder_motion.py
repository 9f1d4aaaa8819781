"""Rules on encoders combined: slips, leaps, and frozen readings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.signals import Doubt, Mode
from hil.loop.probe import fill_probe
from hil.safety import encoder_rules
from hil.safety.residuals import SETTLES_S
from tests.hil.encoder_bench import BOTH_SIGNS, CREEP, ON_ONE_LEG, RATES, Bench, T, after, calm, doubted, six

# -- slips


@ON_ONE_LEG
@BOTH_SIGNS
def test_encoders_flag_small_unexplained_length_changes_that_add_up_to_a_slip(leg, sign):
    """Of the first gap, 1 - T / 50 ms is left a tick later."""
    bench = after(2, length_noise_m=0.25)
    bench.ticks(1, jump=six(sign * 0.3, leg))
    value = sign * 0.3 * (1.0 + 0.6875)
    assert doubted(bench.tick(jump=six(sign * 0.3, leg)), Doubt.SLIP, leg, value, 0.5 + CREEP)
    for gap, why in ((0.155, Doubt.NONE), (0.158, Doubt.SLIP)):  # forgotten in time
        bench = after(2, length_noise_m=0.25)
        for _ in range(20):
            tick = bench.tick(jump=six(sign * gap, leg))
        assert tick["doubt"] == why


@BOTH_SIGNS
def test_encoders_allow_a_slip_of_a_share_of_the_travel_in_the_last_50_ms(sign):
    """Rate noise over all of this time, and a period's delay of a leg that others contradict."""
    bench = after(
        60, rate=sign * RATES, length_noise_m=0.5, rate_noise_m_s=2.0, rate_error=0.5, disturbance_m_s2=64.0
    )
    limit = 1.0 + 0.05 * 2.0 + 4.0 * 128.0 * T * T / 8.0 + CREEP + 0.5 * 0.05 * 8.0 + 0.3 * T * 8.0
    jump = 0.9 * (1.0 + T * 2.0 + 128.0 * T * T / 8.0 + 0.3 * T * 8.0)
    bench.ticks(1, jump=six(jump, 5))
    tick = bench.tick(jump=six(jump, 5))
    assert doubted(tick, Doubt.SLIP, 5, 1.6875 * jump, limit)


@BOTH_SIGNS
def test_encoders_flag_apparent_delays_of_a_leg_moving_alone_that_add_up_to_a_slip(sign):
    for share, why in ((0.17, Doubt.NONE), (0.28, Doubt.SLIP)):
        bench = after(2, rate=six(8.0, 5))
        bench.ticks(1, jump=six(sign * share * T * 8.0, 5))
        assert bench.tick(jump=six(sign * share * T * 8.0, 5))["doubt"] == why


def test_encoders_keep_allowing_a_length_change_that_a_long_silence_explains():
    """Of 50 mm, which 128 m/s^2 explain in four periods, 34 are left a tick later, when 16 are allowed."""
    bench = after(2, disturbance_m_s2=64.0, length_noise_m=1e-3)
    bench.ticks(3, unseen=[1])
    bench.ticks(1, jump=six(0.05, 1))
    assert bench.memory("gaps")[1] == pytest.approx(0.05)
    tick = bench.ticks(1)
    assert bench.memory("gaps")[1] == pytest.approx(0.6875 * 0.05)
    assert calm(tick)
    assert bench.memory("excused")[1] == pytest.approx(0.6875 * (0.05 - 2e-3)), "excludes the noise"
    bench.ticks(40)
    assert bench.memory("excused")[1] < 1e-6
    bench = after(2, disturbance_m_s2=64.0)
    bench.ticks(3, unseen=[1])
    bench.ticks(1)
    assert not bench.memory("excused").any(), "a stall without a length change allows nothing"


# -- leaps


def accelerated(**limits):
    """A bench with wide bounds on lengths, after three ticks at rest with open brakes."""
    wide = {"length_noise_m": 1e3, "open_ticks": 2}
    return after(3, **{**wide, **limits})


@ON_ONE_LEG
@BOTH_SIGNS
def test_encoders_allow_a_rate_jump_within_disturbance_and_noise(leg, sign):
    """From -8 to 8 m/s^2, plus the noise of the last acceleration."""
    limit = 16.0 * T + 2.0 * 0.25 * 2.0
    limits = {"disturbance_m_s2": 8.0, "rate_noise_m_s": 0.25}
    accelerated(**limits).ticks(1, rate=six(sign * 0.999 * limit, leg))
    value = sign * 1.001 * limit
    tick = accelerated(**limits).tick(rate=six(value, leg))
    assert doubted(tick, Doubt.LEAP, leg, value, limit)
    assert calm(accelerated(**limits).tick(rate=six(value, leg, 1.01 * value)))


@BOTH_SIGNS
def test_encoders_flag_an_impossible_acceleration_as_a_rate_jump_only_when_it_ends(sign):
    for then in (96.1, 95.9):
        bench = accelerated(disturbance_m_s2=16.0)
        for n in range(1, 4):
            bench.ticks(1, rate=six(sign * 32.0 * T * n, 3))
        tick = bench.tick(rate=six(sign * then * T, 3))
        assert calm(tick) if then > 96.0 else doubted(tick, Doubt.LEAP, 3, -sign * 32.1 * T, 32.0 * T)


def test_encoders_bound_a_rate_jump_by_the_times_between_the_readings():
    """1.5 T, then 0.5 T: a third of the noise of the last acceleration."""
    bench = accelerated(rate_noise_m_s=0.25, disturbance_m_s2=8.0)
    bench.ticks(1, lateness=0.5, rate=six(3.0 * T, 1))
    value, limit = 9.0, 16.0 * 0.5 * T + 2.0 * 0.25 * (1.0 + 1.0 / 3.0)
    assert doubted(bench.tick(rate=six(9.0 + 4.0 * T, 1)), Doubt.LEAP, 1, value, limit)


def test_encoders_flag_rate_jumps_only_after_the_opening_time_of_the_brakes():
    bench = after(3, length_noise_m=1e3, open_ticks=3, disturbance_m_s2=32.0)
    bench.ticks(1, mode=Mode.IDLE)
    bench.ticks(2)
    bench.ticks(1, rate=six(9.0, 1))
    assert doubted(bench.tick(rate=six(0.0)), Doubt.LEAP, 1, -9.0 - 9.0, 1.0)


def test_encoders_flag_a_rate_jump_only_after_an_earlier_acceleration_is_known():
    bench = after(1, length_noise_m=1e3, open_ticks=0, rate_noise_m_s=1e-3)
    bench.ticks(1, rate=six(9.0, 1))
    assert doubted(bench.tick(rate=six(0.0)), Doubt.LEAP, 1, -18.0, 4e-3)


# -- readings that stand still


class Standing(Bench):
    """One reading is frozen; the other legs move at 1 m/s along the reference. Its own reference may move."""

    def __init__(self, leg, **limits):
        wide = {"length_noise_m": 0.5, "rate_noise_m_s": 0.25, "open_ticks": 0, "push_N": six(300.0)}
        super().__init__(**{**wide, **limits})
        self.leg = leg
        self.rate = six(0.0, leg, 1.0)

    def stand(self, astray=0.0, where=None, **columns):
        """A tick in which a leg, by default the frozen one, is `astray` m off its reference."""
        leg = self.leg if where is None else where
        now_s = (self.n + 1) * T
        q_d = self.length + self.rate * (now_s - self.latched_s) - six(astray, leg)
        return self.tick(q_d=q_d, **columns)


def standing(leg, **limits):
    """A `Standing` bench after its first tick."""
    bench = Standing(leg, **limits)
    bench.stand()
    return bench


RISES = [200.0, 300.0, 300.0, 100.0, -100.0, -300.0]


@ON_ONE_LEG
@BOTH_SIGNS
def test_encoders_with_a_frozen_reading_far_off_the_reference_are_pushed_and_then_flagged(leg, sign):
    bench = Standing(leg)
    assert [bench.stand(sign * 5.0 * (n > 1))["tau"][leg] for n in range(4)] == [0.0] * 4
    for n, force in enumerate(RISES):
        tick = bench.stand(sign * (5.5 if n == 0 else 4.0), tau_asked=six(7.0))
        assert calm(tick)
        assert tick["tau"] == pytest.approx(six(7.0 - sign * force, leg, 7.0))
        assert bench.memory("stood")[leg] == 1
    assert doubted(bench.stand(sign * 12.0), Doubt.STILL, leg, 12.0, 5.0)
    assert not bench.memory("push").any()
    assert not bench.memory("stood").any()


@BOTH_SIGNS
def test_encoders_with_a_frozen_reading_are_first_pushed_towards_the_reference(sign):
    assert standing(2, length_noise_m=0.05).stand(sign * 0.6)["tau"][2] == pytest.approx(-sign * 200.0)


def test_encoders_with_a_frozen_reading_are_pushed_if_another_leg_leaves_its_reference():
    assert standing(2).stand(5.5, where=4)["tau"] == pytest.approx(six(200.0, 2))
    assert standing(2).stand(5.5, where=4, unseen=[4])["tau"] == pytest.approx(six(0.0))


@BOTH_SIGNS
def test_encoders_probe_push_ends_when_the_leg_moves_by_more_than_its_noise(sign):
    bench = standing(2)
    bench.stand(20.0)
    bench.stand(20.0, jump=six(sign * 0.5, 2))
    assert bench.memory("push")[2] == -2
    tick = bench.stand(20.0, jump=six(sign * 0.01, 2))
    assert bench.memory("push")[2] == 0
    assert bench.memory("anchor")[2] == pytest.approx(5.0 + sign * 0.51)
    assert tick["tau"][2] == pytest.approx(-100.0), "what is left of 300 N falls by 200 N a tick"
    assert bench.stand(20.0)["tau"][2] == 0.0
    assert bench.stand(24.9)["tau"][2] == 0.0
    assert bench.stand(25.1)["tau"][2] == pytest.approx(-200.0)


@ON_ONE_LEG
def test_encoders_with_a_frozen_reading_explained_by_friction_are_recorded_but_not_pushed(leg):
    bench = standing(leg, sticks=1)
    assert bench.memory("strays") == 0
    bench.stand(20.0)
    assert bench.memory("strays") == 1 << leg
    assert not bench.memory("push").any()
    bench.stand()
    assert bench.memory("strays") == 0
    bench.stand(20.0, mode=Mode.UNLOADING)
    assert bench.memory("strays") == 0


def test_encoders_restart_the_expected_travel_when_a_frozen_reading_changes():
    bench = standing(2, sticks=1)
    bench.memory("free_m")[2] = bench.memory("free_m_s")[2] = 7.0
    bench.stand(20.0)
    assert bench.memory("free_m")[2] == bench.memory("free_m_s")[2] == 7.0
    bench.stand(20.0, jump=six(5.0, 2))
    assert bench.memory("free_m")[2] == bench.memory("free_m_s")[2] == 0.0


@BOTH_SIGNS
@pytest.mark.parametrize(
    ("both_ways", "most"), [(0, 3), (0b111011, 3), (0b000100, 6)], ids=["one", "another leg's two", "two"]
)
def test_encoders_flag_a_leg_that_still_sticks_after_its_probe_pushes(both_ways, most, sign):
    """One push, or one in each direction under an unknown load."""
    for push in (most, most + 1):
        bench = standing(2, sticks=1)
        bench.safety.memory["both_ways"] = both_ways
        bench.memory("push")[2] = sign * push
        tick = bench.stand(12.0)
        assert calm(tick) if push == most else doubted(tick, Doubt.STILL, 2, 12.0, 5.0)


@ON_ONE_LEG
def test_encoders_do_not_suspect_other_legs_until_a_pushed_leg_has_settled(leg):
    """Otherwise pushes would spread from leg to leg: each moves a leg by more than the suspicion threshold."""
    memory = SimpleNamespace(push=six(0), unsettled_s=six(0.0), began=np.zeros((6, 6)))
    settle = encoder_rules.let_settle
    memory.push[leg] = -1
    settle(memory, six(1.0), 0.2501 * SETTLES_S)
    memory.push[leg] = 0
    for n in range(2, 6):
        expected = np.zeros((6, 6))
        expected[:, leg] = min(n, 4)
        expected[leg, leg] = 0.0
        settle(memory, six(float(n)), 0.2501 * SETTLES_S)
        assert memory.began == pytest.approx(expected), "its own reference may move on"


def test_encoders_count_a_leg_as_unsettled_as_long_as_it_is_pushed():
    bench = standing(2)
    bench.stand(20.0)
    for _ in range(3):
        bench.stand(20.0)
        assert bench.memory("unsettled_s") == pytest.approx(six(SETTLES_S - T, 2))
    bench.stand(20.0, jump=six(0.6, 2))
    bench.stand(20.0)
    assert bench.memory("unsettled_s") == pytest.approx(six(SETTLES_S - 2.0 * T, 2))


@BOTH_SIGNS
def test_encoders_count_a_rate_above_three_times_its_noise_as_motion(sign):
    for rate, push in ((0.75, -1), (0.76, 0)):
        bench = Standing(2)
        bench.rate = six(sign * rate, 2, 1.0)
        bench.stand()
        bench.stand(20.0)
        assert bench.memory("push")[2] == push


def test_encoders_probe_push_pauses_while_the_leg_is_silent_and_continues_later():
    bench = standing(2)
    bench.stand(20.0)
    assert bench.stand(20.0, unseen=[2])["tau"][2] == pytest.approx(-200.0)
    assert bench.stand(20.0)["tau"][2] == pytest.approx(-300.0)


def test_encoders_of_unwatched_legs_are_not_pushed():
    bench = standing(2, watched_legs=63 - 4)
    assert bench.stand(20.0)["tau"][2] == 0.0
    assert bench.memory("stood")[2] == 0


def test_encoders_with_frozen_readings_are_pushed_only_with_open_brakes():
    bench = Standing(2, open_ticks=3)
    for n in range(5):
        bench.stand(20.0 * n)
        assert bench.memory("stood")[2] == (n > 2)
    assert bench.memory("push")[2] == -1
    tick = bench.stand(99.0, mode=Mode.UNLOADING)
    assert bench.memory("push")[2] == bench.memory("stood")[2] == 0
    assert tick["tau"][2] == 0.0


@pytest.mark.parametrize(
    ("sticks", "ticks", "rise", "fall"),
    [(0, 0, 1, 600.0), (0, 1, 1, 600.0), (0, 4, 1, 150.0), (1, 4, 1, 300.0), (1, 12, 9, 300.0 / 9.0)],
)
def test_encoders_probe_push_fades_at_the_same_slope_at_which_it_rises_or_reverses(sticks, ticks, rise, fall):
    limits = SimpleNamespace(push_ticks=ticks, push_N=six(300.0), sticks=sticks, rise_ticks=rise)
    memory, tick = SimpleNamespace(push=six(0, dtype=int)), SimpleNamespace(probe_force=six(900.0))
    fill_probe(tick, tick, limits, memory)
    assert tick.probe_force == pytest.approx(six(900.0 - fall))


def forces(limits, pushes, left_N=0.0):
    """Force added to leg 2 in these ticks of its push."""
    memory, tick, found = SimpleNamespace(push=six(0)), SimpleNamespace(probe_force=six(left_N, 2)), []
    for push in pushes:
        memory.push[2] = push
        fill_probe(tick, tick, limits, memory)
        found.append(float(tick.probe_force[2]))
    return found


@BOTH_SIGNS
def test_encoders_probe_push_fades_at_its_slope_before_it_reverses(sign):
    limits = SimpleNamespace(push_ticks=16, push_N=six(300.0), sticks=0, rise_ticks=1)
    found = forces(limits, [sign * k for k in (1, 2, 3)], left_N=-300.0 * sign)
    assert found == pytest.approx([sign * force for force in (-262.5, -225.0, -187.5)])


@ON_ONE_LEG
def test_encoders_count_a_leg_as_pushed_until_its_probe_force_is_zero(leg):
    probed = encoder_rules.probed
    assert not probed(SimpleNamespace(probe_force=six(0.0)), SimpleNamespace(push=six(0)))
    assert probed(SimpleNamespace(probe_force=six(0.0)), SimpleNamespace(push=six(-1, leg)))
    assert probed(SimpleNamespace(probe_force=six(0.5, leg)), SimpleNamespace(push=six(0)))


# -- rates that are made of lengths: a slope over equal steps lags by a third of one


@ON_ONE_LEG
@BOTH_SIGNS
def test_encoders_allow_the_lag_of_two_differentiated_rates_in_a_length_change(leg, sign):
    """The acceleration range is 16 m/s^2: T^2 / 8 of it, plus T / 2 times the two lags of T / 3."""
    bench = after(5, differences=1, disturbance_m_s2=8.0)
    limit = 16.0 * T * T * (1.0 / 8.0 + 1.0 / 3.0) + CREEP
    assert doubted(bench.tick(jump=six(sign * 1e-2, leg)), Doubt.JUMP, leg, sign * 1e-2, limit)


@ON_ONE_LEG
@BOTH_SIGNS
def test_encoders_allow_the_lag_of_three_differentiated_rates_in_a_rate_jump(leg, sign):
    """T times the range, as for any rate, plus lags: T / 3 of the last slope, three times T / 3 of the previous."""
    limit = 16.0 * T * (1.0 + 4.0 / 3.0)
    for share, doubts in ((0.999, False), (1.001, True)):
        bench = accelerated(differences=1, disturbance_m_s2=8.0)
        bench.ticks(3)
        tick = bench.tick(rate=six(sign * share * limit, leg))
        assert doubted(tick, Doubt.LEAP, leg, sign * share * limit, limit) if doubts else calm(tick)
