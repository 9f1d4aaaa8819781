"""Certificate rule at its limits; the mutation test runs these tests against changed copies of its file."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from hil.safety import certificate
from tests.hil.test_safety_rules import ON_ONE_LEG, six

ROWS = (
    "K_P", "K_D", "P_11", "P_12", "P_22", "disturbance", "noise", "rise", "decay", "slope", "steepness",
)  # fmt: skip
SCALARS = ("pose", "shared", "layer", "action", "confirm", "period")
CRITICAL = {
    "K_P": 400.0, "K_D": 40.0, "P_11": 150e3, "P_12": 3e3, "P_22": 600.0, "disturbance": 8.0,
    "noise": 0.25, "rise": 0.0245, "decay": 0.99, "layer": 1.0, "confirm": 2.0, "period": 0.001,
}  # fmt: skip
"""Critically damped: wn = 20 rad/s, alpha = 5 1/s."""


def watched(**changes):
    """Constants of a watch: rows and scalars by name."""
    table = np.zeros((12, 6))
    for name, value in {**CRITICAL, **changes}.items():
        if name in ROWS:
            table[ROWS.index(name)] = value
        else:
            table[11, SCALARS.index(name)] = value
    return table


def test_certificate_default_has_no_axes_and_sqrt_V_bound_grows_by_the_disturbance():
    """Near zero W grows by the disturbance; farther out it tends towards the disturbance."""
    assert certificate.NO_WATCH.constants.shape == (0, 6)
    assert certificate.NO_WATCH.ticks == 0
    assert certificate.grown(0.5, 8.0, 0.0245, 0.75) == 0.5 + 0.0245 * 8.0
    assert certificate.grown(7.0, 8.0, 1.0, 0.75) == math.sqrt(0.75 * 49.0 + 0.25 * 64.0)
    assert certificate.grown(8.0, 8.0, 1.0, 0.75) == 8.0
    assert certificate.grown(10.0, 8.0, 1.0, 0.75) == math.sqrt(0.75 * 100.0 + 0.25 * 64.0)


def test_certificate_V_is_the_quadratic_form():
    table = watched(P_11=[1, 2, 3, 4, 5, 6], P_12=[0.5, 0.25, 0, 0, 0, 1], P_22=[7, 8, 9, 10, 11, 12])
    assert certificate.lyapunov(table, 1, 0.5, -2.0) == 2 * 0.25 + 2 * 0.25 * 0.5 * -2.0 + 8 * 4.0
    assert certificate.lyapunov(table, 5, -0.5, -2.0) == 6 * 0.25 + 2 * 1.0 + 12 * 4.0
    assert certificate.lyapunov(table, 0, 0.0, 0.0) == 0.0
    assert certificate.lyapunov(watched(P_11=-1.0), 0, 2.0, 0.0) == 0.0, "V below 0 by rounding counts as 0"


def asked_for(table, e, de, feed):
    linear, asked = np.full(6, np.nan), np.full(6, np.nan)
    certificate.asked_for(table, six(0.0) + e, six(0.0) + de, six(0.0) + feed, linear, asked)
    return linear, asked


@ON_ONE_LEG
def test_certificate_demanded_acceleration_inside_the_boundary_layer_follows_the_gains(leg):
    table = watched(K_P=[4, 5, 6, 7, 8, 9], K_D=[1, 2, 3, 1, 2, 3], slope=2.0, steepness=16.0, layer=0.75)
    linear, asked = asked_for(table, six(0.25, leg), six(0.25, leg), np.arange(3.0, 9.0))
    expected = np.arange(3.0, 9.0)
    expected[leg] += 0.25 * (4, 5, 6, 7, 8, 9)[leg] + 0.25 * (1, 2, 3, 1, 2, 3)[leg]
    np.testing.assert_array_equal(linear, expected)
    np.testing.assert_array_equal(asked, expected)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_certificate_demanded_acceleration_beyond_the_boundary_layer_is_smaller(sign):
    table = watched(K_P=4.0, K_D=2.0, slope=2.0, steepness=16.0, layer=0.5)
    linear, asked = asked_for(table, six(0.25 * sign, 1), six(0.5 * sign, 1), 0.0)
    np.testing.assert_array_equal(linear, six(2.0 * sign, 1))
    np.testing.assert_array_equal(asked, six((2.0 - 16.0 * 0.5) * sign, 1), "|de + 2 e| is 1, the layer 0.5")


def test_certificate_boundary_layer_shared_by_all_legs_uses_the_norm_of_all_legs():
    table = watched(K_P=0.0, K_D=0.0, slope=1.0, steepness=16.0, layer=1.0, shared=1.0)
    e, de = np.array([0, 1.0, 0, 0, 0, 0]), np.array([0, 0.5, 0, -2.0, 0, 0])
    _, asked = asked_for(table, e, de, 0.0)
    np.testing.assert_array_equal(asked, -16.0 * (e + de) * (1 - 1 / 2.5))
    table[11, 1] = 0.0
    _, asked = asked_for(table, e, de, 0.0)
    np.testing.assert_array_equal(asked, [0, -16.0 * (1.5 - 1.0), 0, 16.0 * (2.0 - 1.0), 0, 0])
    table[11, 1] = 1.0
    _, asked = asked_for(table, 0.0, six(4.0, 5), 0.0)
    np.testing.assert_array_equal(asked, six(-16.0 * (4.0 - 1.0), 5))

    _, asked = asked_for(watched(layer=0.0, steepness=1.0), 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(
        asked, np.zeros(6), "a layer of zero thickness must demand nothing at zero error"
    )


def moved(q_d=0.0, dq_d=0.0, ddq_d=0.0, q_0=0.0, dq_0=0.0, ddq_0=0.0, leg=3):
    memory = np.zeros((7, 6))
    memory[3], memory[4], memory[5] = six(q_0, leg), six(dq_0, leg), six(ddq_0, leg)
    table = watched(period=0.25, disturbance=[8.0, 80.0, 80.0, 80.0, 80.0, 80.0])
    return certificate.jumped(table, memory, six(q_d, leg), six(dq_d, leg), six(ddq_d, leg))


@ON_ONE_LEG
def test_certificate_reference_change_beyond_its_rates_is_a_jump(leg):
    assert not moved(q_d=0.5, leg=leg)
    assert moved(q_d=0.6, leg=leg)
    assert moved(q_d=-0.6, leg=leg)
    assert not moved(dq_d=2.0, q_d=0.25, leg=leg)
    assert moved(dq_d=2.1, q_d=0.25, leg=leg)
    assert moved(dq_d=-2.1, q_d=-0.25, leg=leg)


def test_certificate_reference_change_by_its_own_rates_is_no_jump():
    assert not moved(q_0=10.0, dq_0=4.0, q_d=11.0, dq_d=4.0)
    assert not moved(dq_0=-4.0, ddq_0=16.0, q_d=-0.5, dq_d=0.0, ddq_d=16.0)
    assert not moved(dq_d=16.0 * 0.25 * 0.5, q_d=0.25, ddq_d=0.0)
    assert not moved(q_d=3.0, q_0=0.0, dq_0=12.0, dq_d=12.0)
    assert not moved(dq_d=7.5, dq_0=0.0, ddq_0=16.0, ddq_d=32.0, q_d=0.95)
    assert moved(dq_d=2.1, ddq_d=0.0, dq_0=0.0)
    assert not moved(ddq_d=16.0)
    assert moved(ddq_d=16.1)


def test_certificate_spread_is_the_distance_to_the_farthest_acceleration_demand_still_acting():
    memory = np.full((9, 6), 99.0)
    memory[6:, 2] = [1.0, -3.0, 2.0]
    assert certificate.spread(memory, 2, 0.5) == 3.5
    assert certificate.spread(memory, 2, -5.0) == 7.0
    memory[6:, 2] = 4.0
    assert certificate.spread(memory, 2, 4.0) == 0.0


def test_certificate_remembers_reference_and_demands_until_reset():
    memory = np.arange(54.0).reshape(9, 6)
    certificate.remember_reference(memory, six(1.0), six(2.0), six(3.0))
    np.testing.assert_array_equal(memory[3:6, 4], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(memory[:3], np.arange(18.0).reshape(3, 6))
    certificate.remember_asked(memory, six(5.0), False)
    np.testing.assert_array_equal(memory[6:, 0], [5.0, 36.0, 42.0])
    certificate.remember_asked(memory, six(7.0), True)
    np.testing.assert_array_equal(memory[6:], np.full((3, 6), 7.0))
    np.testing.assert_array_equal(memory[5], six(3.0))

    memory = np.full((8, 6), 9.0)
    certificate.forget(memory)
    np.testing.assert_array_equal(memory[0], six(9.0))
    np.testing.assert_array_equal(memory[1], np.zeros(6))
    np.testing.assert_array_equal(memory[2], [np.nan, 0.0, 9.0, 9.0, 9.0, 9.0])
    np.testing.assert_array_equal(memory[3:], np.full((5, 6), 9.0))


def test_certificate_counts_limited_forces_for_as_many_ticks_as_they_act():
    memory = np.full((9, 6), 9.0)
    certificate.settle(memory, True)
    left = [memory[2, 1]]
    for _ in range(4):
        certificate.settle(memory, False)
        left.append(memory[2, 1])
    assert left == [3.0, 2.0, 1.0, 0.0, 0.0]
    assert (memory == 9.0).sum() == 9 * 6 - 1


def test_certificate_tick_with_an_estimated_length_and_the_next_one_are_disturbed():
    for before, left in ((0.0, [1.0, 0.0]), (4.0, [3.0, 2.0])):
        memory = np.full((9, 6), 9.0)
        memory[2, 1] = before
        certificate.unsettle(memory)
        for after in left:
            certificate.settle(memory, False)
            assert memory[2, 1] == after
        assert (memory == 9.0).sum() == 9 * 6 - 1


class Watched:
    """Watch with two efforts that act at once, driven by rates de of one axis."""

    def __init__(self, **changes):
        self.table = watched(**changes)
        self.memory, self.judged = np.zeros((8, 6)), SimpleNamespace()
        certificate.forget(self.memory)

    def tick(self, de, leg=3, e=0.0, rate=0.0, feed=0.0, whole=True, late_s=0.0, periods=1.0):
        return certificate.watch(
            self.table, self.memory, six(e, leg), six(de, leg), six(rate, leg), six(feed, leg),
            whole, late_s, periods, self.judged,
        )  # fmt: skip

    @property
    def figures(self):
        """V, its rate, the largest allowed V, the largest W / (bound + noise)."""
        names = ("lyapunov", "lyapunov_rate", "lyapunov_bound", "lyapunov_share")
        return np.array([getattr(self.judged, name) for name in names])


G = math.sqrt(600.0)


@ON_ONE_LEG
def test_certificate_is_broken_if_V_grows_too_fast_for_two_ticks(leg):
    """On each axis |de| may grow by 8 T = 0.008 m/s a tick, 40 de x 2 T of the delay, and noise."""
    for step, broken in ((0.007, False), (0.05, True)):
        watch = Watched(noise=0.0)
        told = [watch.tick(k * step, leg) for k in range(8)]
        assert told[:2] == [False, False]
        assert any(told) == broken
    watch = Watched(noise=0.0)
    assert [watch.tick(de, leg) for de in (0.0, 0.5, 0.0, 0.5, 0.5, 0.5)] == [False] * 4 + [True] * 2
    for confirm in (1, 3):
        watch = Watched(confirm=float(confirm))
        told = [watch.tick(de) for de in (0.0, 0.5, 0.6, 0.7)]
        assert told == [n >= confirm for n in range(4)]


def test_certificate_figures_agree_with_hand_calculation():
    """Two ticks: V, its rate, the allowed V, and the share of it in use."""
    watch = Watched(P_12=0.0, K_P=0.0)
    watch.tick(0.02, 3, e=0.01)
    V_0 = 150e3 * 1e-4 + 600.0 * 4e-4
    np.testing.assert_allclose(watch.figures, [V_0, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(watch.memory[0], six(math.sqrt(V_0) + 0.25, 3, 0.25))
    watch.tick(0.03, 3, e=0.01)
    V_1 = 150e3 * 1e-4 + 600.0 * 9e-4
    own = 8.0 + 40.0 * 0.01
    level = math.sqrt(V_0) + 0.25
    bound = min(level + 0.0245 * own, math.sqrt(0.99 * level**2 + 0.01 * own**2))
    others = 0.25 + 0.0245 * 8.0
    np.testing.assert_allclose(
        watch.figures,
        [V_1, (V_1 - V_0) / 1e-3, bound**2 + 5 * others**2, math.sqrt(V_1) / (bound + 0.25)],
    )
    np.testing.assert_allclose(watch.memory[0], six(min(bound, math.sqrt(V_1) + 0.25), 3, 0.25))
    np.testing.assert_allclose(watch.memory[6:, 3], [40.0 * 0.03, 40.0 * 0.02])
    watch.tick(0.03, 3, e=0.01, periods=4.0)
    np.testing.assert_allclose(watch.figures[1], 0.0)
    watch.tick(0.02, 3, e=0.01, periods=4.0)
    np.testing.assert_allclose(watch.figures[1], (V_0 - V_1) / 4e-3)


def test_certificate_level_is_the_smallest_of_all_ticks():
    watch = Watched(noise=0.0, P_12=0.0)
    watch.tick(1.0)
    for _ in range(5):
        watch.tick(0.1)
        np.testing.assert_allclose(watch.memory[0, 3], 0.1 * G)
    watch.tick(2.0)
    assert 0.1 * G < watch.memory[0, 3] < 2.0 * G
    assert watch.memory[1, 3] == 1.0
    watch.tick(0.1)
    assert watch.memory[1, 3] == 0.0


def test_certificate_noise_and_lateness_do_not_count_as_growth():
    """Sampled 0.1 ms late at 2 m/s, 30 m/s^2 and a disturbance of 8: error 0.2 mm of length, 3.8 mm/s of
    rate.
    """
    late = math.sqrt(150e3) * 2e-4 + G * 3.8e-3
    for rate, feed in ((2.0, 30.0), (-2.0, -30.0)):
        watch = Watched(rise=0.0, decay=1.0, confirm=1.0, K_D=0.0, P_12=0.0)
        watch.tick(0.0, feed=feed)
        np.testing.assert_allclose(watch.memory[0], six(0.25))
        at = (0.25 + 0.25 + late) / G
        assert not watch.tick(0.999 * at, rate=rate, feed=feed, late_s=1e-4)
        np.testing.assert_allclose(watch.figures[3], 0.999)
        assert watch.tick(1.001 * at, rate=rate, feed=feed, late_s=1e-4)
        watch = Watched(rise=0.0, decay=1.0, confirm=1.0, K_D=0.0, P_12=0.0)
        watch.tick(0.0, rate=rate, feed=feed, late_s=1e-4)
        np.testing.assert_allclose(watch.memory[0, 3], 0.25 + late)
    watch = Watched(rise=0.0, decay=1.0, confirm=1.0, K_D=0.0, P_12=0.0, noise=1e-300)
    watch.tick(0.5)
    assert not watch.tick(0.5), "at the bound"


def test_certificate_check_restarts_after_a_disturbed_tick():
    watch = Watched(confirm=1.0)
    watch.tick(0.0)
    assert not watch.tick(1.0, whole=False)
    np.testing.assert_allclose(watch.figures[:2], [600.0, 600.0 / 1e-3])
    assert np.isnan(watch.figures[2:]).all()
    assert watch.memory[6, 3] == 40.0
    assert watch.memory[7, 3] == 0.0, "the earlier demand must still act"
    assert not watch.tick(1.0)
    assert watch.tick(2.0)
    assert not watch.tick(3.0, whole=False)
    np.testing.assert_array_equal(watch.memory[1], np.zeros(6))

    watch = Watched()
    watch.tick(0.5)
    np.testing.assert_array_equal(
        watch.memory[6:, 3], [20.0, 20.0], "the memory of demands must begin with the first demand"
    )


def test_certificate_bound_beyond_the_boundary_layer_allows_the_missing_acceleration():
    watch = Watched(noise=0.0, K_P=0.0, P_12=0.0, slope=0.0, steepness=30.0, layer=0.5)
    watch.tick(1.0)
    watch.tick(1.0)
    allowed = math.sqrt(0.99 * 600.0 + 0.01 * (8.0 + 15.0) ** 2)
    np.testing.assert_allclose(watch.memory[0, 3], min(G, allowed))
    np.testing.assert_allclose(watch.figures[2], min(G + 0.0245 * 23, allowed) ** 2 + 5 * (0.0245 * 8) ** 2)

    # at 1 m/s it asked for 40 - 15 m/s^2; at 0.4 m/s, within the layer, the gains make 16 m/s^2 of it
    watch = Watched(noise=0.0, K_P=0.0, P_12=0.0, slope=0.0, steepness=30.0, layer=0.5)
    watch.tick(1.0)
    watch.tick(0.4)
    allowed = 0.99 * 600.0 + 0.01 * (8.0 + 9.0) ** 2
    np.testing.assert_allclose(watch.figures[2], allowed + 5 * (0.0245 * 8) ** 2)


def test_certificate_check_accepts_any_error_in_its_first_tick():
    """One period later W = 24.5 breaks it, as at most 24.4 is allowed."""
    watch = Watched(noise=0.0, confirm=1.0, K_D=0.0, P_12=0.0)
    for whole in (True, False):
        assert not watch.tick(1.0, whole=whole)
        np.testing.assert_allclose(watch.memory[0, 3], G)
        np.testing.assert_array_equal(watch.memory[1], np.zeros(6))
        assert watch.tick(1.0)
