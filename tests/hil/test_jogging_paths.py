"""What a jog follows: poses and rates of each axis and leg against independent formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.loop.jogging import LegJog, jog_path, pose_rates, setup_share
from tests.hil.test_jogging import HERE, PLATFORM, Q, lengths

SPEEDS = 0.04, 0.3
"""Of set-up, m/s, rad/s."""


def rates(path, t, h=1e-4):
    """Twist and its rate by central differences of poses and twists, (6,) each."""
    before, after = path.sample(t - h), path.sample(t + h)
    turn = Rotation.from_matrix(after.R @ before.R.T).as_rotvec()
    twist = np.concatenate([after.p - before.p, turn]) / (2 * h)
    return twist, (after.twist - before.twist) / (2 * h)


@pytest.mark.parametrize("leg", range(6))
def test_a_leg_jog_keeps_five_lengths_and_its_rates_are_those_of_its_poses(leg):
    rate = np.zeros(6)
    rate[leg] = 0.05
    path = LegJog(PLATFORM, HERE, rate)
    for t in np.arange(0.0, 1.2, 0.01):
        sample = path.sample(t)
        np.testing.assert_allclose(lengths(sample.p, sample.R), Q + t * rate, rtol=0, atol=1e-9)
        np.testing.assert_allclose(sample.R @ sample.R.T, np.eye(3), atol=1e-12)
    for t in (0.2, 0.7, 1.1):
        sample = path.sample(t)
        twist, dtwist = rates(path, t)
        np.testing.assert_allclose(sample.twist, twist, atol=1e-6 * np.abs(twist).max() + 1e-9)
        np.testing.assert_allclose(sample.dtwist, dtwist, atol=1e-4 * np.abs(dtwist).max() + 1e-8)


def test_lengths_of_no_pose_leave_a_leg_jog_where_it_is():
    path = LegJog(PLATFORM, HERE, np.array([1.0, 0, 0, 0, 0, 0]))
    last = path.sample(0.01)
    assert path.ahead(50.0) is None
    assert path.sample(50.0) is last


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("way", [1.0, -0.2])
def test_an_axis_jog_goes_along_or_about_an_axis_of_the_base_at_its_set_up_speed(axis, way):
    rate = np.sign(way) * np.where(np.arange(6) < 3, 0.04, 0.3) * (np.arange(6) == axis)
    path = jog_path(PLATFORM, HERE, axis, SPEEDS, way)
    assert path.duration_s is None
    sample = path.sample(1.5)
    np.testing.assert_allclose(sample.p, HERE.p + 1.5 * rate[:3], atol=1e-15)
    turn = Rotation.from_rotvec(1.5 * rate[3:]).as_matrix()
    np.testing.assert_allclose(sample.R, turn @ HERE.R, atol=1e-14)
    np.testing.assert_array_equal(sample.twist, rate)
    assert not sample.dtwist.any()


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("way", [1.0, -0.2])
def test_a_leg_jog_goes_at_the_set_up_speed_of_lengths_in_the_direction_of_the_word(leg, way):
    path = jog_path(PLATFORM, HERE, 6 + leg, SPEEDS, way)
    sample = path.sample(0.25)
    expected = Q + np.sign(way) * 0.04 * 0.25 * (np.arange(6) == leg)
    np.testing.assert_allclose(lengths(sample.p, sample.R), expected, rtol=0, atol=1e-11)
    assert path.duration_s is None


@pytest.mark.parametrize(
    ("twist", "share"),
    [
        ((0, 0, 0, 0, 0, 0), 1.0),
        ((0.03, 0, 0, 0, 0.1, 0), 1.0),
        ((0.03, -0.04, 0.12, 0, 0, 0), 0.04 / 0.13),
        ((0, 0, 0, 0.3, -0.4, 1.2), 0.3 / 1.3),
        ((0.08, 0, 0, 1.2, 0, 0), 0.25),
        ((0.16, 0, 0, 0.6, 0, 0), 0.25),
    ],
)
def test_the_share_is_that_of_the_slower_of_way_and_turn_and_never_more_than_all(twist, share):
    assert setup_share(HERE._replace(twist=np.array(twist, float)), SPEEDS) == pytest.approx(share, rel=1e-12)


def test_at_a_singular_pose_the_rates_are_no_numbers_and_elsewhere_those_of_the_lengths():
    a, b = PLATFORM.base_joints, PLATFORM.platform_joints
    for found in pose_rates(a, np.zeros_like(b), HERE.p, np.eye(3), np.ones(6)):
        assert np.isnan(found).all()
    dq = np.array([0.01, -0.02, 0.03, 0.0, 0.05, -0.01])
    twist, dtwist = pose_rates(a, b, HERE.p, np.ascontiguousarray(HERE.R), dq)

    def turned(t):
        w = t * (twist[3:] + 0.5 * t * dtwist[3:])
        p = HERE.p + t * (twist[:3] + 0.5 * t * dtwist[:3])
        return lengths(p, Rotation.from_rotvec(w).as_matrix() @ HERE.R)

    h = 1e-3
    np.testing.assert_allclose((turned(h) - turned(-h)) / (2 * h), dq, atol=1e-8)
    np.testing.assert_allclose((turned(h) - 2 * turned(0.0) + turned(-h)) / h**2, 0.0, atol=1e-7)
