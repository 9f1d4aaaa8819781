"""How long the approach takes: by the leg that goes farthest, whichever way it does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.loop.reference import farthest_leg_m
from hil.loop.setup_moves import approach, at_setup_speed
from hil.robot.kinematics import leg_lengths
from hil.trajectory.path import PoseSample

PLATFORM = build_platform(load("virtual").platform)
SPEED_m_s, BLEND_S, PERIOD_S = 0.04, 0.5, 1e-3
HOME = [0.0, 0.0, 1.0]
WAYS = {
    "all legs shorter": ([0.0, 0.0, 0.8], [0.0, 0.0, 0.0]),
    "all legs longer": ([0.0, 0.0, 1.2], [0.0, 0.0, 0.0]),
    "aside": ([0.15, -0.1, 1.0], [0.0, 0.0, 0.0]),
    "a turn": (HOME, [0.1, -0.15, 0.2]),
}


def at(p: list[float], turn: list[float]) -> PoseSample:
    return PoseSample(np.array(p), Rotation.from_rotvec(turn).as_matrix(), np.zeros(6), np.zeros(6))


def parts_of(start: PoseSample, blend_s: float = BLEND_S) -> Any:
    """Return what an approach asks of the parts of a cycle whose reference starts there."""
    return SimpleNamespace(
        platform=PLATFORM,
        trajectory=SimpleNamespace(sample={0.0: start}.__getitem__),
        engage=SimpleNamespace(approach_speed_m_s=SPEED_m_s, blend_s=blend_s),
    )


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("back", [False, True])
def test_the_leg_that_goes_farthest_does_so_at_the_speed_of_the_approach_either_way(
    way: str, back: bool
) -> None:
    ends = at(HOME, [0.0, 0.0, 0.0]), at(*WAYS[way])
    here, there = ends[::-1] if back else ends
    change = leg_lengths(PLATFORM, there.p, there.R) - leg_lengths(PLATFORM, here.p, here.R)
    farthest = float(np.abs(change).max())
    assert farthest / SPEED_m_s > 2.0 * BLEND_S
    assert farthest_leg_m(PLATFORM, here, there) == pytest.approx(farthest, rel=1e-12)
    move = approach(parts_of(there), here, PERIOD_S)
    assert move.duration_s == pytest.approx(farthest / SPEED_m_s, rel=1e-12)
    np.testing.assert_allclose(move.sample(0.0).p, here.p, atol=1e-15)
    np.testing.assert_allclose(move.sample(farthest / SPEED_m_s).p, there.p, atol=1e-12)


@pytest.mark.parametrize(("blend_s", "takes_s"), [(BLEND_S, BLEND_S), (0.0, PERIOD_S)])
def test_a_short_approach_takes_the_blend_and_without_one_a_period(blend_s: float, takes_s: float) -> None:
    here = at(HOME, [0.0, 0.0, 0.0])
    assert approach(parts_of(here, blend_s), here, PERIOD_S).duration_s == takes_s


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
@pytest.mark.parametrize("back", [False, True])
def test_a_move_at_set_up_speed_is_as_fast_as_way_and_turn_allow_and_no_shorter_than_its_least_time(
    by_m: list[float], turn_deg: float, least_s: float, takes_s: float, back: bool
) -> None:
    settings: Any = SimpleNamespace(setup_speed_m_s=0.05, setup_speed_deg_s=10.0)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    ends = at(HOME, [0.0] * 3), at([*(np.array(HOME) + by_m)], [*(np.radians(turn_deg) * axis)])
    here, there = ends[::-1] if back else ends
    move = at_setup_speed(settings, least_s, here, there)
    assert move.duration_s == pytest.approx(takes_s, rel=1e-9)
    np.testing.assert_allclose(move.sample(0.0).p, here.p, atol=1e-15)
    np.testing.assert_allclose(move.sample(takes_s).R, there.R, atol=1e-9)
    fastest = move.sample(0.5 * takes_s).twist
    speeds = np.linalg.norm(fastest[:3]) / 0.05, np.linalg.norm(fastest[3:]) / np.radians(10.0)
    assert max(speeds) <= 1.0 + 1e-9
    assert (max(speeds) == pytest.approx(1.0)) == (takes_s > least_s)
