"""The second pose of a bring-up is within reach, whatever the size of the robot."""

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.lab.bringup.machine import TILT_deg, known_poses
from hil.robot.kinematics import leg_lengths


def with_stroke(c, half_m):
    """A configuration with a stroke that ends `half_m` from the lengths at home."""
    q = leg_lengths(build_platform(c.platform), *pose_arrays(c.platform.home))
    ends = {"length_min_m": float(q.min()) - half_m, "length_max_m": float(q.max()) + half_m}
    return c.model_copy(update={"platform": c.platform.model_copy(update=ends)})


def tilt_deg(c):
    """Tilt of the second pose against the first, deg."""
    (_, home), (_, tilted) = known_poses(c)
    return np.degrees(np.arccos((np.trace(home.T @ tilted) - 1.0) / 2.0))


def reach_m(c):
    """Largest change of a leg length by the whole tilt, m."""
    p, R = pose_arrays(c.platform.home)
    turned = np.add(c.platform.home.rotation_vector_deg, TILT_deg)
    tilted = c.platform.home.model_copy(update={"rotation_vector_deg": tuple(turned.tolist())})
    platform = build_platform(c.platform)
    return float(np.abs(leg_lengths(platform, *pose_arrays(tilted)) - leg_lengths(platform, p, R)).max())


@pytest.mark.parametrize("name", ["virtual", "desktop"])
def test_tilt_of_the_second_known_pose_is_reduced_to_fit_the_stroke(name):
    c = load(name)
    whole = np.linalg.norm(TILT_deg)
    reach = reach_m(c)
    assert tilt_deg(c) == pytest.approx(whole, rel=1e-6)
    assert tilt_deg(with_stroke(c, 1.1 * reach)) == pytest.approx(whole, rel=1e-6)
    assert tilt_deg(with_stroke(c, 0.6 * reach)) == pytest.approx(0.5 * whole, rel=1e-6)
    assert tilt_deg(with_stroke(c, 0.3 * reach)) == pytest.approx(0.25 * whole, rel=1e-6)


def test_home_at_the_end_of_the_stroke_is_refused_with_the_leg():
    c = load("virtual")
    narrow = with_stroke(c, 0.1 * reach_m(c))
    with pytest.raises(ConfigurationError, match=r"leg \d"):
        known_poses(narrow)
