"""What a jog follows: the rate of each axis and leg, the share of its speed at set-up, and where no pose is found."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.loop import jogging
from hil.loop.jogging import AxisJog, LegJog, jog_path, pose_rates, setup_share
from tests.hil.test_jogging import HERE, PLATFORM, lengths

SPEEDS = 0.04, 0.3
"""m/s, rad/s."""


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("way", [1.0, -0.2])
def test_an_axis_goes_at_the_set_up_speed_of_its_kind_in_the_direction_of_the_word(axis, way):
    path = jog_path(PLATFORM, HERE, axis, SPEEDS, way)
    assert isinstance(path, AxisJog)
    expected = np.zeros(6)
    expected[axis] = np.sign(way) * SPEEDS[0 if axis < 3 else 1]
    np.testing.assert_array_equal(path.sample(0.0).twist, expected)
    assert path.duration_s is None


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("way", [1.0, -0.2])
def test_a_leg_goes_at_the_set_up_speed_of_lengths_in_the_direction_of_the_word(leg, way):
    path = jog_path(PLATFORM, HERE, 6 + leg, SPEEDS, way)
    assert isinstance(path, LegJog)
    expected = lengths(HERE.p, HERE.R)
    expected[leg] += np.sign(way) * 0.04 * 0.25
    sample = path.sample(0.25)
    np.testing.assert_allclose(lengths(sample.p, sample.R), expected, rtol=0, atol=1e-11)
    assert path.duration_s is None


def moving(*twist):
    return HERE._replace(twist=np.array(twist, float))


@pytest.mark.parametrize(
    ("twist", "share"),
    [
        ((0, 0, 0, 0, 0, 0), 1.0),
        ((0.04, 0, 0, 0, 0, 0), 1.0),
        ((0.03, 0, 0, 0, 0.1, 0), 1.0),
        ((0.03, -0.04, 0.12, 0, 0, 0), 0.04 / 0.13),
        ((0, 0, 0, 0.3, -0.4, 1.2), 0.3 / 1.3),
        ((0.08, 0, 0, 1.2, 0, 0), 0.25),
        ((0.16, 0, 0, 0.6, 0, 0), 0.25),
    ],
)
def test_the_share_is_that_of_the_slower_of_way_and_turn_and_never_more_than_all(twist, share):
    assert setup_share(moving(*twist), SPEEDS) == pytest.approx(share, rel=1e-12)


def test_what_was_sampled_last_is_known_ahead_without_another_search():
    path = LegJog(PLATFORM, HERE, 0.05 * np.eye(6)[2])
    first = path.ahead(0.0)
    assert path.sample(0.0) is first
    np.testing.assert_array_equal(first.p, HERE.p)
    later = path.sample(0.1)
    assert path.ahead(0.1) is later
    assert path.ahead(0.2) is not later


def test_a_pose_at_which_a_rate_is_not_finite_is_none(monkeypatch):
    path = LegJog(PLATFORM, HERE, 0.05 * np.eye(6)[2])
    last = path.sample(0.0)
    twist = np.array([1.0, 2.0, np.inf, 3.0, 4.0, 5.0])
    monkeypatch.setattr(jogging, "pose_rates", lambda *_: (twist, twist))
    assert path.ahead(0.1) is None
    assert path.sample(0.1) is last


def test_at_a_singular_pose_the_rates_are_no_numbers_and_elsewhere_those_of_the_lengths():
    a, b = PLATFORM.base_joints, PLATFORM.platform_joints
    flat = np.zeros_like(b)
    for rates in pose_rates(a, flat, HERE.p, np.eye(3), np.ones(6)):
        assert np.isnan(rates).all()
    dq = np.array([0.01, -0.02, 0.03, 0.0, 0.05, -0.01])
    twist, dtwist = pose_rates(a, b, HERE.p, np.ascontiguousarray(HERE.R), dq)

    def turned(t):
        w = t * (twist[3:] + 0.5 * t * dtwist[3:])
        p = HERE.p + t * (twist[:3] + 0.5 * t * dtwist[:3])
        return lengths(p, Rotation.from_rotvec(w).as_matrix() @ HERE.R)

    h = 1e-3
    np.testing.assert_allclose((turned(h) - turned(-h)) / (2 * h), dq, atol=1e-8)
    np.testing.assert_allclose((turned(h) - 2 * turned(0.0) + turned(-h)) / h**2, 0.0, atol=1e-7)
