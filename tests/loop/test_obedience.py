"""Detection of a drive that does not obey, on synthetic ticks of the book's platform: both sides of each
limit.
"""

import numpy as np
import pytest

from drivers.tick_columns import new_record
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.loop.obedience import Obedience
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian

LEGS = pytest.mark.parametrize("leg", range(6))
SIGNS = pytest.mark.parametrize("sign", [1.0, -1.0])


@pytest.fixture(scope="module")
def home():
    c = load("virtual")
    platform = build_platform(c.platform)
    return Model(platform), *pose_arrays(c.platform.home), jacobian(platform, *pose_arrays(c.platform.home))


class Watch:
    def __init__(self, home, rate_Hz=1000.0):
        self.model, self.p, self.R, self.J = home
        self.obedience = Obedience(self.model, rate_Hz)

    def __call__(self, rates, tau, age=()):
        tick = new_record()
        tick["rate"], tick["age"], tick["p"], tick["R"], tick["J"] = rates, 0, self.p, self.R, self.J
        tick["age"][list(age)] = 1
        return self.obedience.watch(tick, np.asarray(tau, float))


@pytest.fixture
def watch(home):
    return Watch(home)


def only(leg, value):
    six = np.zeros(6)
    six[leg] = value
    return six


def of_force(home, leg, faster):
    """Rates of all legs, m/s, after a force along one leg has made that leg faster by `faster`."""
    model, p, R, J = home
    twist = np.linalg.solve(model.mass_matrix(p, R), J[leg])
    return J @ twist * faster / (J @ twist)[leg]


@LEGS
@SIGNS
@pytest.mark.parametrize(("faster", "refused"), [(0.099, False), (0.101, True)])
def test_leg_faster_by_0_1_m_per_s_against_its_force_loses_its_force(watch, home, leg, sign, faster, refused):
    start = np.full(6, sign)
    assert not watch(start, -start)
    assert watch(start + of_force(home, leg, sign * faster), -start) is refused
    assert watch.obedience.refused == (leg if refused else None)


def test_push_on_the_platform_removes_the_force_of_no_leg(watch, home):
    model, p, R, J = home
    twist = np.linalg.solve(model.mass_matrix(p, R), [0, 0, -20e3, 0, 0, 0])
    watch(np.zeros(6), np.zeros(6))
    for ms in range(1, 20):
        rates = J @ twist * 1e-3 * ms
        assert not watch(rates, -rates)


@SIGNS
def test_disobedient_drive_is_detected_by_the_change_of_leg_rates_within_20_ms(watch, sign):
    tau = only(3, -sign)
    for speed in np.arange(0.0, 0.4, 0.0052):
        assert not watch(only(3, sign * speed), tau)
    assert watch.obedience.refused is None
    for speed in np.arange(0.4, 0.6, 0.0054):
        watch(only(3, sign * speed), tau)
    assert watch.obedience.refused == 3


def test_disobedient_drive_is_detected_only_by_measured_motion_against_its_force(watch):
    for speed in (0.1, 0.5, 0.9):
        assert not watch(only(1, speed), only(1, 1.0))
        assert not watch(only(1, speed), np.zeros(6))
        assert not watch(only(4, speed), only(4, -1.0), age=(4,))


def test_only_one_disobedient_leg_loses_its_force_until_a_reset(watch):
    watch(only(2, 0.1), only(2, -1.0))
    assert watch(only(2, 0.3), only(2, -1.0))
    assert not watch(only(5, 0.9), only(5, -1.0)), "one cause is the sparsest"
    assert watch.obedience.refused == 2
    watch.obedience.reset()
    assert watch.obedience.refused is None


@pytest.mark.parametrize("begin", [Obedience.forget, Obedience.reset])
def test_leg_rates_before_a_fault_or_reset_are_not_used_to_detect_a_disobedient_drive(watch, begin):
    watch(only(5, 0.1), only(5, -1.0))
    begin(watch.obedience)
    assert not watch(only(5, 0.9), only(5, -1.0))
    assert watch(only(5, 1.1), only(5, -1.0))


@LEGS
def test_single_leg_on_closed_brakes_counts_as_disobedient_above_a_rate_gain_of_0_1_m_per_s(home, leg):
    for faster, refused in ((0.1, False), (np.nextafter(0.1, 1.0), True)):
        watch = Watch(home)
        watch(np.zeros(6), only(leg, -1.0))
        assert watch(only(leg, faster), only(leg, -1.0)) is refused


@LEGS
def test_disobedient_leg_is_detected_if_other_legs_have_at_most_0_3_of_the_total_rate_change(home, leg):
    """Next to 91 of the leg, 25, 13 and 5 of others: 819 of 9100 in squares, which is 0.3^2."""
    for one_more, refused in ((0.0, True), (1e-9, False)):
        watch = Watch(home)
        change = np.roll([91.0, 25.0 + one_more, 13.0, 5.0, 0.0, 0.0], leg) / 512.0
        watch(np.zeros(6), only(leg, -1.0))
        assert watch(change, only(leg, -1.0)) is refused


@pytest.mark.parametrize("rate_Hz", [20.0, 50.0, 100.0])
def test_loop_below_100_Hz_detects_a_disobedient_drive_by_rates_of_consecutive_periods(home, rate_Hz):
    watch = Watch(home, rate_Hz)
    tau = only(3, -1.0)
    for speed in (0.0, 0.09, 0.18, 0.27):
        assert not watch(only(3, speed), tau)
    assert watch(only(3, 0.38), tau)


@LEGS
def test_period_with_an_unmeasured_leg_is_not_used_to_detect_a_disobedient_drive(watch, leg):
    tau = only(3, -1.0)
    assert not watch(only(3, 0.0), tau)
    assert not watch(only(3, 0.5), tau, age=(leg,))
    assert not watch(only(3, 0.05), tau)
    assert watch(only(3, 0.12), tau)
