"""Six uncoupled legs, each a nonlinear mass-spring-damper: for commissioning drives without a platform."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, OUT_VECTOR, REAL, VECTOR, helper, kernel
from drivers.errors import PlantError
from drivers.signals import LEGS
from plant_fmu.config import BenchPlant
from plant_fmu.plant import Truth, whole_steps

BRAKE_FORCE_N = 20_000.0
"""Largest force of an engaged brake."""


@helper
def _acceleration(x: float, v: float, f: float, m: float, b: float, k0: float, k1: float) -> float:
    """Solve m a + b v|v| + k0 x + k1 x^3 = f for a."""
    return (f - b * v * abs(v) - k0 * x - k1 * x * x * x) / m


@helper
def advance_leg(
    x: float,
    v: float,
    force: float,
    friction: float,
    h: float,
    n: int,
    m: float,
    b: float,
    k0: float,
    k1: float,
) -> tuple[float, float]:
    """Take n Runge-Kutta 4 steps of h seconds on one leg; return its x and v.

    friction: largest force of its engaged brake. Over a step it applies the force that brings the rate to
    zero at its end, or its largest one.
    """
    for _ in range(n):
        f = force
        if friction > 0.0:
            stop = -m * (v / h + _acceleration(x, v, f, m, b, k0, k1))
            f += min(max(stop, -friction), friction)
        a1 = _acceleration(x, v, f, m, b, k0, k1)
        v2 = v + 0.5 * h * a1
        a2 = _acceleration(x + 0.5 * h * v, v2, f, m, b, k0, k1)
        v3 = v + 0.5 * h * a2
        a3 = _acceleration(x + 0.5 * h * v2, v3, f, m, b, k0, k1)
        v4 = v + h * a3
        a4 = _acceleration(x + h * v3, v4, f, m, b, k0, k1)
        x += h / 6.0 * (v + 2.0 * (v2 + v3) + v4)
        v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    return x, v


@kernel(OUT_VECTOR, OUT_VECTOR, VECTOR, VECTOR, REAL, INTEGER, REAL, REAL, REAL, REAL)
def _advance(
    x: Any, v: Any, force: Any, friction: Any, h: float, n: int, m: float, b: float, k0: float, k1: float
) -> None:
    """Let all legs take n steps, see `advance_leg`; x and v are changed in place."""
    for i in range(x.size):
        x[i], v[i] = advance_leg(x[i], v[i], force[i], friction[i], h, n, m, b, k0, k1)


class Bench:
    """Plant: m x'' + b x'|x'| + k0 x + k1 x^3 = f per leg, x = length - rest length, from rest at x = 0.

    Equation: the nonlinear mass-spring-damper of Slotine and Li, Applied Nonlinear Control (1991), chapter 3.
    An engaged brake is dry friction of at most `BRAKE_FORCE_N`. A wrench has no platform to act on.

    Mutable state: x and x' of the six legs.
    """

    def __init__(self, settings: BenchPlant) -> None:
        self.settings = settings
        self.internal_step_s = settings.internal_step_us / 1e6
        self.reset()

    def reset(self) -> tuple[Array, Array]:
        """Back to rest at the rest length; lengths (6,) m, rates (6,) m/s."""
        self._x = np.zeros(LEGS)
        self._v = np.zeros(LEGS)
        return self._measured()

    def _measured(self) -> tuple[Array, Array]:
        return self._x + self.settings.rest_length_m, self._v.copy()

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold force (6,) N and brake (6,) 0..1 for `dt_s`; lengths (6,) m and rates (6,) m/s at its end.

        Raises PlantError on a dt that is no multiple of the internal step, or a value that is not finite; the
        state is then as before.
        """
        h = self.internal_step_s
        n = whole_steps(dt_s, h)
        if not (np.isfinite(force).all() and np.isfinite(brake).all() and np.isfinite(wrench).all()):
            raise PlantError(f"force {force}, brake {brake}, wrench {wrench}: a value is not finite")
        s = self.settings
        x, v = self._x.copy(), self._v.copy()
        springs = s.stiffness_N_m, s.stiffness_N_m3
        _advance(x, v, force, brake * BRAKE_FORCE_N, h, n, s.mass_kg, s.damping_N_s2_m2, *springs)
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            raise PlantError(
                f"the bench diverged under {force} N: stiffness or damping is too large for plant.model."
                f"internal_step_us = {s.internal_step_us:g}"
            )
        self._x, self._v = x, v
        return self._measured()

    def truth(self) -> Truth | None:
        """None: there is no platform."""
        return None

    def applied_force(self) -> Array | None:
        """None: there is no lag to know of."""
        return None

    def close(self) -> None:
        """Nothing to free."""
