"""Six uncoupled legs, each a nonlinear mass-spring-damper: for commissioning drives without a platform."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import data_at, pointed, reals_at
from drivers.errors import PlantError
from drivers.signals import LEGS
from plant_fmu.config import BenchPlant
from plant_fmu.plant import Moved, PointedPlant

BRAKE_FORCE_N = 20_000.0
"""Largest force of an engaged brake."""
BENCH = np.dtype(
    [
        ("x", "<f8", (LEGS,)),
        ("v", "<f8", (LEGS,)),
        *((name, "<f8") for name in ("step_s", "mass", "damping", "stiffness", "hardening", "rest")),
    ]
)
"""x and x' of the six legs; SI: internal step, m, b, k0, k1, rest length."""
NOT_FINITE, DIVERGED = 1, 2
"""Why the bench does not move."""


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


@helper
def _all_finite(values: Array) -> bool:
    for value in values:  # noqa: SIM110 - compiled
        if not np.isfinite(value):
            return False
    return True


@pointed(record(BENCH), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def _move(b: Any, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
    """As `Moved.move`: 0, NOT_FINITE or DIVERGED; the state is then as before."""
    f, brakes, into = reals_at(force, LEGS), reals_at(brake, LEGS), reals_at(measured, 2 * LEGS)
    if not (_all_finite(f) and _all_finite(brakes) and _all_finite(reals_at(wrench, LEGS))):
        return NOT_FINITE
    x, v = np.empty(LEGS), np.empty(LEGS)
    for i in range(LEGS):
        friction = brakes[i] * BRAKE_FORCE_N
        x[i], v[i] = advance_leg(
            b.x[i], b.v[i], f[i], friction, b.step_s, steps, b.mass, b.damping, b.stiffness, b.hardening
        )
    if not (_all_finite(x) and _all_finite(v)):
        return DIVERGED
    b.x[:], b.v[:] = x, v
    for i in range(LEGS):
        into[i], into[LEGS + i] = x[i] + b.rest, v[i]
    return 0


@pointed(record(BENCH), INTEGER)
def _applied(_b: Any, _force: int) -> int:
    """As `Moved.applied`: there is no lag to know of."""
    return 0


class Bench(PointedPlant):
    """Plant: m x'' + b x'|x'| + k0 x + k1 x^3 = f per leg, x = length - rest length, from rest at x = 0.

    Equation: the nonlinear mass-spring-damper of Slotine and Li, Applied Nonlinear Control (1991), chapter 3.
    An engaged brake is dry friction of at most `BRAKE_FORCE_N`. A wrench has no platform to act on.

    Mutable state: x and x' of the six legs.
    """

    def __init__(self, settings: BenchPlant) -> None:
        self.settings = settings
        self.internal_step_s = settings.internal_step_us / 1e6
        self._record = np.zeros((), BENCH)
        for name, value in {
            "step_s": self.internal_step_s,
            "mass": settings.mass_kg,
            "damping": settings.damping_N_s2_m2,
            "stiffness": settings.stiffness_N_m,
            "hardening": settings.stiffness_N_m3,
            "rest": settings.rest_length_m,
        }.items():
            self._record[name] = value

    def reset(self) -> tuple[Array, Array]:
        """Back to rest at the rest length; lengths (6,) m, rates (6,) m/s."""
        self._record["x"] = self._record["v"] = 0.0
        return np.full(LEGS, self.settings.rest_length_m), np.zeros(LEGS)

    def _refused(self, status: int, force: Array, brake: Array, wrench: Array, _steps: int) -> PlantError:
        if status == NOT_FINITE:
            return PlantError(f"force {force}, brake {brake}, wrench {wrench}: a value is not finite")
        return PlantError(
            f"the bench diverged under {force} N: stiffness or damping is too large for plant.model."
            f"internal_step_us = {self.settings.internal_step_us:g}"
        )

    def moved(self) -> Moved:
        """Return this plant by address."""
        return Moved(_move.address, _applied.address, data_at(self._record), self._refused, self)
