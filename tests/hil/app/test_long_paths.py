"""Paths too long to be looked at in every tick: jumps of force are found, progress is told, memory is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.app import reachability
from hil.app.check.progress import line
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform
from hil.app.log_budget import TICK_BYTES, needed_bytes
from hil.app.reachability import SAMPLES, span_s, violations, walk
from hil.config.reference import HoldReference
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


@pytest.mark.parametrize("duration_s", [1.0, 86_400.0, 1e9])
def test_a_hold_of_any_length_that_is_allowed_is_looked_at(duration_s):
    hold = build_trajectory(
        HoldReference(type="hold", duration_s=duration_s), VIRTUAL_C.platform.home, Path()
    )
    platform = build_platform(VIRTUAL_C.platform)
    w = walk(platform, Model(platform), hold, span_s(hold), PERIOD_S, VIRTUAL_C.plant)
    assert w.t[-1] == duration_s
    assert not np.abs(w.dq).max()
    assert needed_bytes(VIRTUAL_C, duration_s, None) == round((duration_s + 30.0) * 1000.0 * TICK_BYTES)


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


def test_on_so_long_a_path_that_250_ms_are_few_samples_they_are_not_judged():
    w, _ = walked([(0, 1.0), (2000.0, 1.05)])
    assert w.swings(PERIOD_S) is None
    nearer, _ = walked([(0, 1.0), (900.0, 1.05)])
    assert nearer.swings(PERIOD_S) is not None


def test_the_line_tells_how_far_it_is_and_how_long_it_takes():
    assert line(30.0, 90.0, 10.0, 10.0) == (
        "along the reference, with all that may ride on it: 30 of 90 s, about 30 s left; Ctrl-C ends it"
    )
    assert "left" not in line(10.0, 90.0, 0.0, 10.0)


def test_fewer_samples_find_the_same_jump(monkeypatch):
    whole, _ = walked([(0, 1.0), (2.0, 1.05)])
    monkeypatch.setattr(reachability, "SAMPLES", 100)
    coarse, _ = walked([(0, 1.0), (2.0, 1.05)])
    assert np.abs(coarse.steps()[1]).max() == pytest.approx(np.abs(whole.steps()[1]).max(), rel=1e-9)
