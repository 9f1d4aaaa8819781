"""Numbers of a run, against what can be counted by hand."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from hil.config.reference import WaypointReference
from hil.record.metrics import (
    bandwidth_Hz,
    force_shares,
    peak,
    rms,
    rotation_errors,
    step_response,
    total_variation,
)
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.trajectory.path import PoseSample
from hil.trajectory.waypoints import waypoint_trajectory


def test_total_variation_is_the_way_up_and_down_however_finely_sampled():
    """Three periods of a cosine of amplitude 2 go 24 up and down; a ramp goes its height once."""
    t = np.linspace(0.0, 3.0, 3001)
    x = np.column_stack([2.0 * np.cos(2 * np.pi * t), 5.0 * t])
    assert total_variation(x) == pytest.approx([24.0, 15.0], rel=1e-12)


def test_a_force_that_jumps_at_every_tick_costs_its_jump_a_tick():
    assert total_variation(np.array([[1.0], [-1.0]] * 50)) == pytest.approx([198.0])


@pytest.mark.parametrize("rows", [0, 1])
def test_without_two_rows_nothing_varies(rows):
    assert total_variation(np.zeros((rows, 6))).tolist() == [0.0] * 6


# -- errors --------------------------------------------------------------------------------------------------


def test_a_sine_peaks_at_its_amplitude_and_has_the_root_of_two_less_rms():
    t = np.linspace(0.0, 1.0, 4000, endpoint=False)
    x = np.column_stack([3.0 * np.sin(2 * np.pi * t), -2.0 * np.ones_like(t)])
    assert peak(x) == pytest.approx([3.0, 2.0], rel=1e-6)
    assert rms(x) == pytest.approx([3.0 / np.sqrt(2), 2.0], rel=1e-12)


def test_rotation_errors_are_the_rotation_vectors_of_scipy():
    random = np.random.default_rng(3)
    a, b = Rotation.random(50, random_state=random), Rotation.random(50, random_state=random)
    expected = (a * b.inv()).as_rotvec()
    found = rotation_errors(a.as_matrix(), b.as_matrix().reshape(-1, 9))
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_small_rotation_error_keeps_its_digits():
    R = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()[None]
    small = np.array([2e-8, -1e-8, 3e-8])
    R_d = (Rotation.from_rotvec(small) * Rotation.from_matrix(R[0])).as_matrix()[None]
    np.testing.assert_allclose(rotation_errors(R_d, R)[0], small, atol=1e-15)
    assert not rotation_errors(R, R).any()


def test_rotations_without_a_counterpart_are_refused():
    with pytest.raises(ValueError, match="zip"):
        rotation_errors(np.array([np.eye(3)] * 2), np.array([np.eye(3)]))


def test_without_a_row_nothing_peaks_and_there_is_no_mean():
    assert peak(np.zeros((0, 6))).tolist() == [0.0] * 6
    assert np.isnan(rms(np.zeros((0, 6)))).tolist() == [True] * 6
    assert rms(np.full((1, 2), -3.0)).tolist() == [3.0, 3.0]


# -- a step of the set-point, against the second-order loop wn^2 / (s^2 + 2 zeta wn s + wn^2) ----------------

WN = 20.0
T: Any = np.arange(2000) * 1e-3


def second_order(t: Any, zeta: float, wn: float = WN) -> Any:
    if zeta == 1.0:
        return 1.0 - (1.0 + wn * t) * np.exp(-wn * t)
    wd = wn * np.sqrt(1.0 - zeta**2)
    return 1.0 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t))


@pytest.mark.parametrize("zeta", [0.3, 0.5, 0.7])
def test_overshoot_is_that_of_a_second_order_loop(zeta):
    found = step_response(T, 5.0 + 0.25 * second_order(T, zeta), 5.0)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), rel=2e-3)
    assert (found.initial, found.final) == pytest.approx((5.0, 5.25), abs=1e-5)
    assert found.settled


@pytest.mark.parametrize("zeta", [0.5, 1.0])
def test_rise_time_is_that_of_a_second_order_loop(zeta):
    ends = [brentq(lambda t, level=level: second_order(t, zeta) - level, 0.0, 0.25) for level in (0.1, 0.9)]
    found = step_response(T, -second_order(T, zeta), 0.0)
    assert found.rise_s == pytest.approx(ends[1] - ends[0], rel=1e-3)


@pytest.mark.parametrize("zeta", [0.3, 0.7, 1.0])
def test_bandwidth_is_that_of_a_second_order_loop(zeta):
    """|G(j w)|^2 = 1/2 at w^2 = wn^2 (1 - 2 zeta^2 + sqrt(1 + (1 - 2 zeta^2)^2))."""
    a = 1 - 2 * zeta**2
    expected = WN / (2 * np.pi) * np.sqrt(a + np.sqrt(1 + a**2))
    assert bandwidth_Hz(T, 3.0 + 1e-3 * second_order(T, zeta), 3.0) == pytest.approx(expected, rel=1e-3)


def test_a_first_order_loop_has_its_corner_as_bandwidth_and_ln_9_as_rise():
    tau = 0.05
    y = 1 - np.exp(-T / tau)
    assert bandwidth_Hz(T, y, 0.0) == pytest.approx(1 / (2 * np.pi * tau), rel=1e-3)
    found = step_response(T, y, 0.0)
    assert found.rise_s == pytest.approx(tau * np.log(9), rel=1e-3)
    assert found.overshoot == 0.0


def test_a_slow_loop_has_its_corner_as_bandwidth_where_the_record_is_long_enough():
    t: Any = np.arange(6000) * 1e-2
    tau = 5.0
    found = bandwidth_Hz(t, 1 - np.exp(-t / tau), 0.0)
    assert found == pytest.approx(1 / (2 * np.pi * tau), rel=2e-3)


def test_rise_is_between_the_crossings_on_the_straight_lines_between_samples_however_far_apart():
    """10 % is a fifth of the way from 0 to 50 %, 90 % is half the way from 80 to 100 %."""
    t = np.array([0.0, 1.0, 3.0, 5.0, *range(6, 42)])
    y = 7.0 - 2.0 * np.array([0.0, 0.5, 0.8, 1.0, *[1.0] * 36])
    assert step_response(t, y, 7.0).rise_s == pytest.approx(4.0 - 0.2)
    assert step_response(t + 9.0, y, 7.0).rise_s == pytest.approx(4.0 - 0.2)


def test_an_answer_that_is_there_at_once_rises_in_no_time():
    assert step_response(np.arange(20.0) + 3.0, np.ones(20), 0.0).rise_s == 0.0


def test_what_has_not_come_to_rest_says_so():
    assert not step_response(T, np.sin(2 * np.pi * 3 * T) + T, 0.0).settled


@pytest.mark.parametrize(("by", "settled"), [(0.019, True), (0.021, False)])
def test_an_answer_has_settled_within_two_per_cent_of_its_way(by, settled):
    t = np.linspace(0.0, 0.1, 100)
    y = np.array([1.0 + by, 1.0 - by] * 50)
    assert step_response(t, y, 0.0).settled is settled


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("by", "settled"), [(0.019, True), (0.021, False)])
def test_an_answer_that_swings_out_to_one_side_alone_has_not_settled_either(by, settled, sign):
    """Nine of ten samples lie a little on the other side of their mean."""
    t, y = np.linspace(0.0, 0.1, 100), np.ones(100)
    y[-10:] = 1.0 - sign * by / 9
    y[-4] = 1.0 + sign * by
    assert step_response(t, 7.0 + 5.0 * y, 7.0).settled is settled


@pytest.mark.parametrize(("count", "last"), [(1, 1), (2, 1), (9, 1), (10, 1), (19, 1), (20, 2), (35, 3)])
def test_an_answer_ends_at_the_mean_of_its_last_tenth_of_one_sample_at_least(count, last):
    y = np.arange(count) ** 2 + 1.0
    found = step_response(np.arange(float(count)), y, 0.0)
    assert found.final == pytest.approx(y[count - last :].mean())
    assert found.initial == 0.0


def test_an_answer_that_waits_at_a_level_has_reached_it_when_it_came():
    """10 % is reached at 1 s and 90 % at 5 s; the one is kept for two seconds, the other for three."""
    y = np.array([0.0, 0.1, 0.1, 0.1, 0.5, 0.9, 0.9, 0.9, 0.9, *[1.0] * 11])
    assert step_response(np.arange(20.0), y, 0.0).rise_s == pytest.approx(4.0)


def test_an_answer_of_which_a_number_is_missing_at_the_end_has_no_rise_time():
    y = np.array([0.0, *[1.0] * 18, np.nan])
    assert np.isnan(step_response(np.arange(20.0), y, 0.0).rise_s)


@pytest.mark.parametrize(
    ("y", "over"), [([0.0, 1.3, 1.0], 0.3), ([0.0, 0.7, 1.0], 0.0), ([-1.0, 0.5, 1.0], 0.0)]
)
def test_overshoot_is_a_share_of_the_way_and_never_negative(y, over):
    assert step_response(np.arange(3.0), np.array(y), 0.0).overshoot == pytest.approx(over, abs=1e-15)


def test_three_samples_are_the_fewest_that_have_a_bandwidth():
    y = np.array([0.5, 0.9, 1.0])
    assert np.isnan(bandwidth_Hz(T[:2], y[:2], 0.0))
    found = bandwidth_Hz(T[:3], y, 0.0)
    assert 0.0 < found < 500.0
    assert abs(
        0.5 + 0.4 * np.exp(-2e-3j * np.pi * found) + 0.1 * np.exp(-4e-3j * np.pi * found)
    ) == pytest.approx(np.sqrt(0.5), rel=1e-9)


@pytest.mark.parametrize("begins_s", [0.0, 7.0])
def test_a_bandwidth_just_below_half_the_rate_of_the_samples_is_found(begins_s):
    """Increments of 84 and 16 %: |G|^2 = 0.84^2 + 0.16^2 + 2 * 0.84 * 0.16 cos(2 pi f T) = 1 / 2."""
    expected = np.arccos((0.5 - 0.84**2 - 0.16**2) / (2 * 0.84 * 0.16)) / (2 * np.pi * 1e-3)
    assert 400.0 < expected < 500.0
    found = bandwidth_Hz(begins_s + T[:3], np.array([0.84, 1.0, 1.0]), 0.0)
    assert found == pytest.approx(expected, rel=1e-9)


def test_the_bandwidth_is_where_the_gain_first_falls_though_it_rises_again_and_whenever_the_record_begins():
    """Two equal steps a time D apart: |G| = |cos(pi f D)|, which is 1 / sqrt(2) at f D = 1 / 4, 3 / 4 and so on."""
    y = np.where(T < 0.1, 0.5, 1.0)
    assert bandwidth_Hz(T, y, 0.0) == pytest.approx(2.5, rel=1e-9)
    assert bandwidth_Hz(T + 7.0, -3.0 * y, 0.0) == pytest.approx(2.5, rel=1e-9)


def test_what_does_not_answer_has_no_rise_and_no_bandwidth():
    still = np.full_like(T, 2.0)
    found = step_response(T, still, 2.0)
    assert np.isnan(found.rise_s)
    assert not found.settled
    assert np.isnan(bandwidth_Hz(T, still, 2.0))


def test_an_answer_within_one_sample_has_no_bandwidth_below_that_of_the_samples():
    assert np.isnan(bandwidth_Hz(T, np.ones_like(T), 0.0))


# -- what the force is made of -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def book():
    data = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())
    platform = Platform.from_dict(data["geometry"])
    points = [
        {"t_s": k["t"], "position_m": k["p"], "rotation_vector_deg": k["rotvec_deg"]}
        for k in data["trajectory"]["knots"]
    ]
    path = WaypointReference.model_validate({"type": "waypoints", "interpolation": "cubic", "points": points})
    return Model(platform), waypoint_trajectory(path)


def test_on_the_books_path_H_is_little_and_the_rate_of_the_jacobian_is_not(book):
    """Figures found independently: H at most 0.51 % of the force, (dJ/dt) twist 15.7 %, 1188 N."""
    model, path = book
    shares = force_shares(model, [path.sample(t) for t in np.linspace(0, 2 - 1e-12, 2001)])
    assert shares["H"].share == pytest.approx(0.0051, abs=5e-5)
    assert shares["J_dot"].share == pytest.approx(0.157, abs=5e-4)
    assert shares["J_dot"].force_N == pytest.approx(1188, abs=1)


def test_at_rest_gravity_is_the_whole_force(book):
    model, path = book
    shares = force_shares(model, [path.sample(-1.0)])
    assert shares["G"].share == pytest.approx(1.0, rel=1e-12)
    assert shares["H"] == shares["J_dot"] == (0.0, 0.0)


def test_a_platform_that_hangs_pulls_with_its_whole_weight(book):
    model, path = book
    p, R, *rest = path.sample(-1.0)
    shares = force_shares(model, [PoseSample(-p, R, *rest)])
    assert shares["G"].share == pytest.approx(1.0, rel=1e-12)
    assert shares["G"].force_N > 0.0


def test_the_worst_share_and_the_largest_force_of_a_term_are_each_of_their_own_instant(book):
    model, path = book
    sample = path.sample(-1.0)
    J = jacobian(model.platform, sample.p, sample.R)
    legs = np.array([1.0, -2.0, 0.5, 0.0, 1.0, 1.5])
    instants = [(8.0, 1.0, 0.25), (1.0, 0.5, 0.25), (0.0, 3.0, 2.0), (40.0, 2.0, -5.0)]
    at = iter(instants)
    now: list[tuple[float, float, float]] = []

    def whole(*_):
        now[:] = [next(at)]
        return now[0][0] * legs

    stub: Any = SimpleNamespace(
        platform=model.platform,
        inverse_dynamics=whole,
        mass_matrix=lambda *_: np.eye(6),
        coriolis=lambda *_: J.T @ (now[0][1] * legs),
        gravity=lambda *_: J.T @ (now[0][2] * legs),
    )
    shares = force_shares(stub, [sample] * len(instants))
    assert shares["H"] == pytest.approx((0.5, 6.0))
    assert shares["G"] == pytest.approx((0.25, 10.0))
    assert shares["J_dot"] == (0.0, 0.0)
    assert list(shares) == ["H", "J_dot", "G"]
    assert force_shares(stub, []) == dict.fromkeys(shares, (0.0, 0.0))
