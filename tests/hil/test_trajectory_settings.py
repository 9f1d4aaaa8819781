"""What the settings of a reference say beside its path: where it begins, and whether it may be repeated."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError
from hil.config.reference import HoldReference, LiveReference, MultisineReference, SinusoidReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.waypoints import SAME, require_closed
from tests.live_reference import LIVE_REFERENCE

HOME = Pose(position_m=(0.1, -0.2, 1.0), rotation_vector_deg=(3.0, -4.0, 5.0))
ELSEWHERE = Pose(position_m=(-0.05, 0.15, 1.2), rotation_vector_deg=(-6.0, 2.0, 8.0))
LIMITS = LIVE_REFERENCE["limits"]
COMPONENT = {"axis": "x_m", "amplitude": 0.1, "frequency_Hz": 0.7}
LINES = {"axis": "x_m", "band_Hz": (0.5, 3.0), "lines": 5, "amplitude": 0.05}
KINDS: dict[str, tuple[Any, str, dict[str, Any]]] = {
    "hold": (HoldReference, "pose", {}),
    "sinusoids": (SinusoidReference, "centre", {"components": [COMPONENT], "ramp_s": 1.0, "duration_s": 5.0}),
    "multisine": (
        MultisineReference,
        "centre",
        {"axes": [LINES], "period_s": 4.0, "periods": 1, "ramp_s": 1.0},
    ),
    "live": (LiveReference, "start", {"limits": LIMITS}),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pose", [ELSEWHERE, None], ids=["elsewhere", "home"])
def test_a_reference_begins_at_the_pose_of_its_settings_and_without_one_at_home(kind, pose):
    model, name, settings = KINDS[kind]
    begins = {} if pose is None else {name: pose}
    sample = build_trajectory(model(type=kind, **settings, **begins), HOME, Path()).sample(0.0)
    expected = pose or HOME
    np.testing.assert_allclose(sample.p, expected.position_m, atol=1e-15)
    turn = Rotation.from_matrix(sample.R).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, expected.rotation_vector_deg, atol=1e-9)


@pytest.mark.parametrize("word", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_path_that_ends_to_either_side_of_its_start_is_not_repeated(word, sign):
    chi = np.full((3, 6), 0.5)
    chi[-1, word] += sign * 0.9 * SAME
    require_closed(chi, None, "path")
    chi[-1, word] = 0.5 + sign * 1e-3
    require_closed(chi, 1, "path")
    for periods in (2, None):
        with pytest.raises(ConfigurationError, match=r"the path ends 0\.001 m or rad away from its start"):
            require_closed(chi, periods, "path")


@pytest.mark.parametrize("axis", ["rx_deg", "ry_deg", "rz_deg"])
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sinusoids_about_a_centre_that_is_turned_either_way_stay_within_half_a_turn(axis, side, sign):
    turn = tuple(side * 165.0 * (name == axis) for name in ("rx_deg", "ry_deg", "rz_deg"))

    def reach(amplitude: float) -> None:
        settings = {
            "type": "sinusoids",
            "components": [{"axis": axis, "amplitude": sign * amplitude, "frequency_Hz": 0.7}],
            "duration_s": 5.0,
            "centre": {"position_m": (0.0, 0.0, 1.0), "rotation_vector_deg": turn},
        }
        build_trajectory(SinusoidReference.model_validate(settings), HOME, Path())

    reach(14.9)
    with pytest.raises(ConfigurationError, match="at most 180 deg"):
        reach(15.1)
