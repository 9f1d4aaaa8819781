"""Paths too long to be looked at in every tick: jumps of force are found, progress is told, memory is not."""

from __future__ import annotations

import numpy as np
import pytest

from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform
from hil.app.reachability import SAMPLES, span_s, violations, walk
from hil.robot.dynamics import Model
from hil.trajectory.build import build_trajectory

VIRTUAL_C = load("virtual")
VIRTUAL = VIRTUAL_C.text
PERIOD_S = 1e-3


def walked(points, interpolation="cubic", force_step_N=4000):
    """Walk along waypoints (t_s, z_m)."""
    begin, end = VIRTUAL.index("reference:  "), VIRTUAL.index("limits:  ")
    listed = ", ".join(f"{{t_s: {t}, position_m: [0, 0, {z}]}}" for t, z in points)
    section = f"reference: {{type: waypoints, interpolation: {interpolation}, points: [{listed}]}}\n"
    text = f"{VIRTUAL[:begin]}{section}{VIRTUAL[end:]}"
    text = text.replace("force_step_N: 4000 ", f"force_step_N: {force_step_N} ")
    c = loads(text, "my.yaml")
    platform = build_platform(c.platform)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, Model(platform), trajectory, span_s(trajectory), PERIOD_S, c.plant)
    return w, [v.message for v in violations(w, c.platform, c.limits, PERIOD_S)]


LATE = [(0, 1.0), (40.0, 1.0), (40.5, 1.05), (80.0, 1.05)]
"""Rest for 40 s, then a cubic move of half a second, whose acceleration jumps: 6 x 0.05 / 0.5^2 = 1.2 m/s^2."""


def test_a_jump_in_the_middle_of_a_long_path_is_seen_as_on_a_short_one():
    """The same move alone, looked at in every tick, has the same jump of the leg forces."""
    w, _ = walked(LATE)
    short, _ = walked([(0, 1.0), (0.5, 1.05)])
    assert not w.every_tick
    assert short.every_tick
    assert len(w.t) == SAMPLES + 1
    t, step = w.steps()
    # Each of six legs lifts a sixth of 1.2 m/s^2 times some 1300 kg, over the sine of its slope.
    assert 300.0 < np.abs(step).max() < 700.0
    assert np.abs(step).max() == pytest.approx(np.abs(short.steps()[1]).max(), rel=0.02)
    assert t[np.abs(step).max(axis=1).argmax()] == pytest.approx(40.0, abs=2.5e-3)


def test_a_jump_beyond_the_limit_is_refused_on_a_long_path_too():
    _, found = walked(LATE, force_step_N=200)
    assert any("limits.force_step_N 200 in one tick" in each for each in found)
    assert not walked(LATE, force_step_N=800)[1]
