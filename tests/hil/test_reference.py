"""Reference in leg lengths, and the approach to it, against the book's platform and finite differences."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.reference import WaypointReference
from hil.config.values import Pose
from hil.contracts.records import referred
from hil.loop.operating import approach, at_setup_speed
from hil.loop.reference import farthest_leg_m
from hil.robot.geometry import Platform
from hil.robot.kinematics import leg_lengths
from hil.trajectory.build import build_trajectory
from hil.trajectory.path import PoseSample

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


def test_leg_lengths_and_rates_agree_with_the_book():
    for state in BOOK["states"]:
        reference = referred(PLATFORM, TRAJECTORY.sample(state["t"]))
        np.testing.assert_allclose(reference["q_d"], state["length"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(reference["dq_d"], state["rate"], rtol=0, atol=1e-9)


def test_leg_acceleration_agrees_with_finite_differences_of_the_rate():
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


def at(p: list[float], turn: Any = (0.0, 0.0, 0.0)) -> PoseSample:
    return PoseSample(np.array(p), Rotation.from_rotvec(turn).as_matrix(), np.zeros(6), np.zeros(6))


def approach_to(start: PoseSample, here: PoseSample, blend_s: float = BLEND_S) -> Any:
    parts: Any = SimpleNamespace(
        platform=PLATFORM,
        trajectory=SimpleNamespace(sample={0.0: start}.__getitem__),
        engage=SimpleNamespace(approach_speed_m_s=SPEED_m_s, blend_s=blend_s),
    )
    return approach(parts, here, PERIOD_S)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("back", [False, True])
def test_leg_with_the_longest_travel_moves_at_the_approach_speed(way: str, back: bool) -> None:
    ends = at(HOME), at(*WAYS[way])
    here, there = ends[::-1] if back else ends
    change = leg_lengths(PLATFORM, there.p, there.R) - leg_lengths(PLATFORM, here.p, here.R)
    farthest = float(np.abs(change).max())
    assert farthest / SPEED_m_s > 2.0 * BLEND_S
    assert farthest_leg_m(PLATFORM, here, there) == pytest.approx(farthest, rel=1e-12)
    move = approach_to(there, here)
    assert move.duration_s == pytest.approx(farthest / SPEED_m_s, rel=1e-12)
    np.testing.assert_allclose(move.sample(0.0).p, here.p, atol=1e-15)
    np.testing.assert_allclose(move.sample(farthest / SPEED_m_s).p, there.p, atol=1e-12)


@pytest.mark.parametrize(("blend_s", "takes_s"), [(BLEND_S, BLEND_S), (0.0, PERIOD_S)])
def test_approach_of_zero_length_takes_blend_s_or_at_least_one_period(blend_s: float, takes_s: float) -> None:
    assert approach_to(at(HOME), at(HOME), blend_s).duration_s == takes_s


@pytest.mark.parametrize(
    ("by_m", "turn_deg", "least_s", "takes_s"),
    [
        ([0.03, -0.04, 0.12], 0.0, 0.5, 1.875 * 0.13 / 0.05),
        ([0.0, 0.0, 0.0], 20.0, 0.5, 1.875 * 20.0 / 10.0),
        ([0.03, -0.04, 0.12], 20.0, 0.5, 1.875 * 0.13 / 0.05),
        ([0.03, -0.04, 0.12], 40.0, 0.5, 1.875 * 40.0 / 10.0),
        ([0.03, -0.04, 0.12], 40.0, 9.5, 9.5),
    ],
)
def test_a_move_at_set_up_speed_obeys_both_speed_limits(
    by_m: list[float], turn_deg: float, least_s: float, takes_s: float
) -> None:
    settings: Any = SimpleNamespace(setup_speed_m_s=0.05, setup_speed_deg_s=10.0)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    here, there = at(HOME), at([*(np.array(HOME) + by_m)], np.radians(turn_deg) * axis)
    for a, b in ((here, there), (there, here)):
        move = at_setup_speed(settings, least_s, a, b)
        assert move.duration_s == pytest.approx(takes_s, rel=1e-9)
        np.testing.assert_allclose(move.sample(0.0).p, a.p, atol=1e-15)
        np.testing.assert_allclose(move.sample(takes_s).R, b.R, atol=1e-9)
        fastest = move.sample(0.5 * takes_s).twist
        speeds = np.linalg.norm(fastest[:3]) / 0.05, np.linalg.norm(fastest[3:]) / np.radians(10.0)
        assert max(speeds) <= 1.0 + 1e-9
        assert (max(speeds) == pytest.approx(1.0)) == (takes_s > least_s)
