"""Simulation of six legs under a law, written for the tests of learning.

Each leg obeys y'' = gain F(v) + d, F a delay of whole ticks, a lag and optionally a resonance; the law
demands v = a_d + K_P e + K_D de + a. Steps are a tenth of a tick, by the semi-implicit Euler method.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.design.stability.sampled_loop import gains, sampled_axis
from hil.lab.learn.convergence import AxisLoop, axis_loop, frequencies
from hil.mathematics.linear_system import lag

T = 1e-3
PARTS = 10
K_P, K_D = 400.0, 40.0
LEAD = 450
FAULT_M = 0.01
"""Following error that ends a run."""


@dataclass(frozen=True)
class Plant:
    """Parameters of the six legs; the defaults are the nominal ones."""

    gain: Any = 1.0
    delay: int = 1
    """Ticks."""
    lag_s: float = 0.8e-3
    resonance_Hz: float = 0.0
    damping: float = 0.02
    share: float = 1.0
    """Share of the force that passes the resonance."""
    coupling: Any = field(default_factory=lambda: np.eye(6))
    learned: Any = field(default_factory=lambda: np.eye(6))
    """Matrix (6, 6) applied to the learned accelerations."""
    friction: float = 0.0
    """m/s^2."""
    stiffness: float = 0.0
    """1/s^2, of a spring about the start."""
    noise_m: float = 0.0


def path(n: int) -> tuple[Any, Any, Any]:
    """Position, rate and acceleration (n + 1, 6) of a motion over 1 s, from rest to rest and back."""
    w = 2.0 * np.pi
    t = np.clip(T * np.arange(n + 1), 0.0, 1.0)[:, None]
    size = np.array([0.1, -0.06, 0.08, 0.05, -0.09, 0.07])
    q = size * (1.0 - np.cos(w * t)) ** 2 / 4.0
    dq = size * w * (1.0 - np.cos(w * t)) * np.sin(w * t) / 2.0
    ddq = size * w * w * ((np.sin(w * t)) ** 2 + (1.0 - np.cos(w * t)) * np.cos(w * t)) / 2.0
    return q, dq, ddq


def run(plant: Plant, a: Any, believed: float, seed: int = 0) -> tuple[Any, Any] | None:
    """Measured errors and their rates (LEAD + 1000, 6); None if the following error ended the run.

    a: learned acceleration (LEAD + 1000, 6); believed: share of the reference acceleration in the law.
    """
    count = len(a) - LEAD
    q_d, dq_d, ddq_d = path(count)
    y, dy, force, x, dx = (np.zeros(6) for _ in range(5))
    queue = [np.zeros(6)] * (plant.delay + 1)
    rng = np.random.default_rng(seed)
    e, de = np.zeros((len(a), 6)), np.zeros((len(a), 6))
    wr, h = 2.0 * np.pi * plant.resonance_Hz, T / PARTS
    for k in range(len(a)):
        j = max(k - LEAD, 0)
        e[k] = q_d[j] - y + plant.noise_m * rng.standard_normal(6)
        de[k] = dq_d[j] - dy
        if np.abs(e[k]).max() > FAULT_M:
            return None
        asked = believed * ddq_d[j] + K_P * e[k] + K_D * de[k] + plant.learned @ a[k]
        queue = [*queue[1:], asked]
        v = queue[0]
        for _ in range(PARTS):
            force += (v - force) * (h / plant.lag_s)
            if wr > 0.0:
                dx += h * (wr * wr * (force - x) - 2.0 * plant.damping * wr * dx)
                x = x + h * dx
            through = (1.0 - plant.share) * force + plant.share * x if wr > 0.0 else force
            push = plant.coupling @ (plant.gain * through) - plant.stiffness * y
            dy += h * (push - plant.friction * np.tanh(dy / 1e-3))
            y = y + h * dy
    return e, de


def nominal(e: Any) -> tuple[list[AxisLoop], Any]:
    """Nominal loop of each leg, and its frequencies, for errors (n, 6)."""
    f = frequencies(len(e), T)
    return [axis_loop(sampled_axis(1e-3, lag(0.8e-3), T), gains(K_P, K_D, T), f, looks_ahead=False)] * 6, f
