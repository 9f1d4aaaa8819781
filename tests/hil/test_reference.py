"""The reference in leg lengths and the approach to it, against the book's platform and finite differences."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import Mode
from hil.config.reference import WaypointReference
from hil.config.values import Pose
from hil.contracts.records import referred
from hil.loop.reference import farthest_leg_m
from hil.loop.setup_moves import approach, at_setup_speed
from hil.robot.geometry import Platform
from hil.robot.kinematics import leg_lengths
from hil.trajectory.build import build_trajectory
from tests.hil.test_cycle_again import a_bench

BOOK = json.loads((Path(__file__).parent.parent / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
TRAJECTORY = build_trajectory(
    WaypointReference.model_validate(
        {
            "type": "waypoints",
            "interpolation": "cubic",
            "points": [
                {"t_s": k["t"], "position_m": k["p"], "rotation_vector_deg": k["rotvec_deg"]}
                for k in BOOK["trajectory"]["knots"]
            ],
        }
    ),
    Pose(position_m=(0, 0, 1)),
    None,
)


def test_lengths_and_rates_are_the_books():
    for state in BOOK["states"]:
        reference = referred(PLATFORM, TRAJECTORY.sample(state["t"]))
        np.testing.assert_allclose(reference["q_d"], state["length"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(reference["dq_d"], state["rate"], rtol=0, atol=1e-9)


def test_leg_acceleration_is_the_derivative_of_the_rate():
    h = 1e-3
    for t in np.linspace(0.05, 0.95, 19):
        ddq = referred(PLATFORM, TRAJECTORY.sample(t))["ddq_d"]
        rate = {k: referred(PLATFORM, TRAJECTORY.sample(t + k * h / 2))["dq_d"] for k in (-2, -1, 1, 2)}
        expected = (4 * (rate[1] - rate[-1]) / h - (rate[2] - rate[-2]) / (2 * h)) / 3
        np.testing.assert_allclose(ddq, expected, rtol=0, atol=1e-8)


# -- the way to it

SPEED_m_s, BLEND_S, PERIOD_S = 0.04, 0.5, 1e-3
HOME = [0.0, 0.0, 1.0]
WAYS = {
    "all legs shorter": ([0.0, 0.0, 0.8], [0.0, 0.0, 0.0]),
    "all legs longer": ([0.0, 0.0, 1.2], [0.0, 0.0, 0.0]),
    "a turn": (HOME, [0.1, -0.15, 0.2]),
}


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.LOADING, Mode.PARKED])
def test_where_nothing_is_followed_the_reference_is_where_the_platform_is(mode):
    bench = moved_in(mode)
    tick = bench.cycle.tick
    assert bench.cycle.mode is mode
    np.testing.assert_array_equal(tick["p_d"], tick["p"])
    np.testing.assert_array_equal(tick["R_d"], tick["R"])
    assert not tick["twist_d"].any()


@pytest.mark.parametrize("mode", [Mode.RELEASING, Mode.PARKING, Mode.UNLOADING])
def test_from_the_release_to_the_test_of_the_brakes_it_is_where_the_platform_should_stand(mode):
    bench = moved_in(mode)
    tick, home = bench.cycle.tick, bench.cycle.parts.home_p
    assert bench.cycle.mode is mode
    np.testing.assert_allclose(tick["p_d"], home, atol=1e-6)
    assert np.abs(tick["p"] - home).max() > 4e-6
    assert not tick["twist_d"].any()


def moved_in(mode):
    """A bench whose legs are 5 um longer since the second tick of a mode; what it is a tick later."""
    bench = a_bench()
    stops = mode in {Mode.PARKING, Mode.UNLOADING, Mode.PARKED}
    bench.until(Mode.APPROACH if stops else mode)
    bench.step((Operator.STOP,) * stops)
    while bench.cycle.mode is not mode:
        bench.step()
        assert bench.tick < 2000
    bench.drives.length = bench.drives.length + 5e-6
    for _ in range(2):
        bench.step()
    return bench
