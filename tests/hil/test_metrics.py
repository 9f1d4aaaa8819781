"""Metrics of a run against values calculated by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from hil.config.reference import WaypointReference
from hil.record.metrics import bandwidth_Hz, force_shares, peak, rms, rotation_errors, step_response
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.trajectory.path import PoseSample
from hil.trajectory.waypoints import waypoint_trajectory


def test_peak_and_rms_of_a_sine_are_exact_and_of_no_rows_zero_and_nan():
    t = np.linspace(0.0, 1.0, 4000, endpoint=False)
    x = np.column_stack([3.0 * np.sin(2 * np.pi * t), -2.0 * np.ones_like(t)])
    assert peak(x) == pytest.approx([3.0, 2.0], rel=1e-6)
    assert rms(x) == pytest.approx([3.0 / np.sqrt(2), 2.0], rel=1e-12)
    assert peak(np.zeros((0, 6))).tolist() == [0.0] * 6
    assert np.isnan(rms(np.zeros((0, 6)))).tolist() == [True] * 6


def test_rotation_errors_agree_with_scipy():
    random = np.random.default_rng(3)
    a, b = Rotation.random(50, random_state=random), Rotation.random(50, random_state=random)
    found = rotation_errors(a.as_matrix(), b.as_matrix().reshape(-1, 9))
    np.testing.assert_allclose(found, (a * b.inv()).as_rotvec(), atol=1e-9)
    small = Rotation.from_rotvec([[2e-8, -1e-8, 3e-8]])
    R = b[:1].as_matrix()
    np.testing.assert_allclose(rotation_errors((small * b[:1]).as_matrix(), R), small.as_rotvec(), atol=1e-15)
    assert not rotation_errors(R, R).any()
    with pytest.raises(ValueError, match="zip"):
        rotation_errors(np.array([np.eye(3)] * 2), R)


WN = 20.0
T: Any = np.arange(2000) * 1e-3


def second_order(t: Any, zeta: float, wn: float = WN) -> Any:
    if zeta == 1.0:
        return 1.0 - (1.0 + wn * t) * np.exp(-wn * t)
    wd = wn * np.sqrt(1.0 - zeta**2)
    return 1.0 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t))


@pytest.mark.parametrize("zeta", [0.3, 0.5, 0.7])
def test_overshoot_of_a_second_order_loop_is_exact(zeta):
    found = step_response(T, 5.0 + 0.25 * second_order(T, zeta), 5.0)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), rel=2e-3)
    assert (found.initial, found.final) == pytest.approx((5.0, 5.25), abs=1e-5)
    assert found.settled


@pytest.mark.parametrize("zeta", [0.5, 1.0])
def test_rise_time_of_a_second_order_loop_is_exact(zeta):
    ends = [brentq(lambda t, level=level: second_order(t, zeta) - level, 0.0, 0.25) for level in (0.1, 0.9)]
    found = step_response(T, -second_order(T, zeta), 0.0)
    assert found.rise_s == pytest.approx(ends[1] - ends[0], rel=1e-3)


@pytest.mark.parametrize("zeta", [0.3, 0.7, 1.0])
def test_bandwidth_of_a_second_order_loop_is_exact(zeta):
    """|G(j w)|^2 = 1/2 at w^2 = wn^2 (1 - 2 zeta^2 + sqrt(1 + (1 - 2 zeta^2)^2))."""
    a = 1 - 2 * zeta**2
    expected = WN / (2 * np.pi) * np.sqrt(a + np.sqrt(1 + a**2))
    assert bandwidth_Hz(T, 3.0 + 1e-3 * second_order(T, zeta), 3.0) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("tau", "period_s", "count"), [(0.05, 1e-3, 2000), (5.0, 1e-2, 6000)])
def test_bandwidth_and_rise_time_of_a_first_order_loop_are_exact(tau, period_s, count):
    t: Any = np.arange(count) * period_s
    y = 1 - np.exp(-t / tau)
    assert bandwidth_Hz(t, y, 0.0) == pytest.approx(1 / (2 * np.pi * tau), rel=2e-3)
    found = step_response(t, y, 0.0)
    assert found.rise_s == pytest.approx(tau * np.log(9), rel=1e-3)
    assert found.overshoot == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("y", "rise_s"),
    [
        (np.ones(20), 0.0),
        ([0.0, 0.1, 0.1, 0.1, 0.5, 0.9, 0.9, 0.9, 0.9, *[1.0] * 11], 4.0),
        ([0.0, *[1.0] * 18, np.nan], np.nan),
        (np.zeros(20), np.nan),
    ],
    ids=["at once", "waits at 10 and 90 %", "a number is missing", "no answer"],
)
def test_rise_time_uses_the_first_crossing_of_each_level(y, rise_s):
    found = step_response(np.arange(20.0) + 3.0, np.array(y), 0.0)
    assert found.rise_s == pytest.approx(rise_s, nan_ok=True)


def test_a_signal_without_response_or_rest_has_not_settled():
    still = np.full_like(T, 2.0)
    assert not step_response(T, still, 2.0).settled
    assert not step_response(T, np.sin(2 * np.pi * 3 * T) + T, 0.0).settled
    assert np.isnan(bandwidth_Hz(T, still, 2.0))
    assert np.isnan(bandwidth_Hz(T, np.ones_like(T), 0.0)), "no bandwidth of a response within a sample"


def test_bandwidth_is_the_first_frequency_at_which_the_gain_falls():
    """Two equal steps a time D apart: |G| = |cos(pi f D)|, which is 1 / sqrt(2) at f D = 1 / 4, 3 / 4 and so on."""
    y = np.where(T < 0.1, 0.5, 1.0)
    assert bandwidth_Hz(T, y, 0.0) == pytest.approx(2.5, rel=1e-9)
    assert bandwidth_Hz(T + 7.0, -3.0 * y, 0.0) == pytest.approx(2.5, rel=1e-9)


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


def test_coriolis_share_of_the_force_on_the_textbook_path_is_small_and_that_of_dJ_dt_is_not(book):
    """Independent figures: H at most 0.51 % of the force, (dJ/dt) twist 15.7 %, 1188 N."""
    model, path = book
    shares = force_shares(model, [path.sample(t) for t in np.linspace(0, 2 - 1e-12, 2001)])
    assert shares["H"].share == pytest.approx(0.0051, abs=5e-5)
    assert shares["J_dot"].share == pytest.approx(0.157, abs=5e-4)
    assert shares["J_dot"].force_N == pytest.approx(1188, abs=1)


def test_gravity_share_of_the_leg_forces_at_rest_is_one_above_and_below_the_base(book):
    model, path = book
    p, R, *rest = path.sample(-1.0)
    for pose in (p, -p):
        shares = force_shares(model, [PoseSample(pose, R, *rest)])
        assert shares["G"].share == pytest.approx(1.0, rel=1e-12)
        assert shares["G"].force_N > 0.0
        assert shares["H"] == shares["J_dot"] == (0.0, 0.0)
