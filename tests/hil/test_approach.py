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
from hil.loop.setup_moves import approach
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
