"""Twist and acceleration from leg lengths alone, against the analytic motion of the lengths."""

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.arrays import Array
from hil.lab.identify.estimators.leg_motion import (
    LegSignals,
    bell,
    half_ticks,
    platform_motion,
    smooth,
)
from hil.mathematics.rotations import rotation_from_vector, rotation_motion_kernel
from hil.robot.geometry import Platform
from hil.robot.kinematics import leg_lengths

BOOK = json.loads((Path(__file__).parents[3] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
T = 1e-3
AMPLITUDE = np.array([0.08, 0.07, 0.06, 0.08, 0.09, 0.1])
OMEGA = 2 * np.pi * np.array([0.5, 0.7, 0.9, 0.8, 1.1, 1.3])
CENTRE = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def state(t, axes=range(6)):
    """Position, rotation, twist and its rate, for sinusoids on some axes."""
    moved = AMPLITUDE * np.isin(np.arange(6), list(axes))
    chi = CENTRE + moved * np.sin(OMEGA * t)
    rate, second = moved * OMEGA * np.cos(OMEGA * t), -moved * OMEGA**2 * np.sin(OMEGA * t)
    R, w, dw = rotation_motion_kernel(chi[3:].copy(), rate[3:].copy(), second[3:].copy())
    return chi[:3], R, np.concatenate([rate[:3], w]), np.concatenate([second[:3], dw])


def signals(n, good=None):
    states = [state(k * T) for k in range(n)]
    p, R = np.array([s[0] for s in states]), np.array([s[1] for s in states])
    length = np.array([leg_lengths(PLATFORM, *s[:2]) for s in states])
    return LegSignals(
        T, length, length, np.sin(length), p, R, np.ones(n, bool) if good is None else good
    ), states


@pytest.mark.parametrize("half", [4, 10, 30])
def test_differentiating_filter_is_exact_for_parabolas(half):
    b = bell(half, T)
    t: Array = np.arange(200.0) * T
    x = (1.7 + 3.0 * t + 11.0 * t * t)[:, None]
    inside = slice(half, -half)
    np.testing.assert_allclose(smooth(b.first, x)[inside, 0], 3.0 + 22.0 * t[inside], rtol=0, atol=1e-9)
    np.testing.assert_allclose(smooth(b.second, x)[inside, 0], 22.0, rtol=0, atol=1e-6)
    assert b.value.sum() == pytest.approx(1.0, abs=1e-14)


def test_value_rate_and_acceleration_pass_the_same_filter():
    """Each is that of the sinusoid times one factor, without a phase shift."""
    b = bell(10, T)
    w, t = 2 * np.pi * 15.0, np.arange(400) * T
    x = np.sin(w * t)[:, None]
    k = 207
    share = smooth(b.value, x)[k, 0] / np.sin(w * t[k])
    assert 0.8 < share < 1.0
    assert smooth(b.first, x)[k, 0] / (w * np.cos(w * t[k])) == pytest.approx(share, rel=2e-3)
    assert smooth(b.second, x)[k, 0] / (-(w**2) * np.sin(w * t[k])) == pytest.approx(share, rel=2e-3)


def test_twist_and_acceleration_follow_from_lengths_alone():
    made, states = signals(300)
    begin = made._replace(
        p=made.p + 1e-3, R=np.array([rotation_from_vector(np.full(3, 1e-3)) @ R for R in made.R])
    )
    motion = platform_motion(PLATFORM, begin)
    half = half_ticks(T)
    assert motion.good[half:-half].all()
    twist, dtwist = np.array([s[2] for s in states]), np.array([s[3] for s in states])
    inside = slice(half, -half)
    assert np.abs(motion.twist - twist)[inside].max() < 1e-3 * np.abs(twist).max()
    assert np.abs(motion.dtwist - dtwist)[inside].max() < 1e-3 * np.abs(dtwist).max()
    force = np.cos(made.length) * np.gradient(made.length, T, axis=0)
    assert np.abs(motion.dforce - force)[inside].max() < 2e-3 * np.abs(force).max()
