"""Six uncoupled legs, each a nonlinear mass-spring-damper: for commissioning drives without a platform."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import data_at, pointed, reals_at
from drivers.errors import PlantError
from drivers.signals import LEGS
from plant_fmu.config import BenchPlant
from plant_fmu.plant import MEASURED, Moved, PointedPlant

BRAKE_FORCE_N = 20_000.0
"""Largest force of an engaged brake, N."""
HAND_M, HAND_m_s = 3e-3, 0.1
"""Largest displacement and speed with which a leg that yields takes a hand along."""
_OF_A_LEG = (
    *("x", "v", "mass", "damping", "stiffness", "hardening", "origin", "rest"),
    *("friction", "brake", "shortest", "longest", "hand", "hand_from"),
)
BENCH = np.dtype([("step_s", "<f8"), *((name, "<f8", LEGS) for name in _OF_A_LEG)])
"""step_s: internal step. Per leg, SI: x and x'; m, b, k0, k1; the x at which the springs are relaxed; the
length at x = 0; largest forces of friction and of the engaged brake, which add up; both ends of x; the force
of a hand on the leg, and the x at which the hand was applied."""
NOT_FINITE, DIVERGED = 1, 2
"""Reasons for which the legs did not move: status of `_move`."""


@helper
def _acceleration(b: Any, i: int, f: float, damping: float, x: float, v: float) -> float:
    """Acceleration a, m/s^2, of leg i that solves m a + b v|v| + k0 x + k1 x^3 = f; x m, v m/s, f N."""
    a = (f - damping * v * abs(v) - b.stiffness[i] * x - b.hardening[i] * x * x * x) / b.mass[i]
    return float(a)


@helper
def _advanced(
    b: Any, i: int, steps: int, force: float, friction: float, damping: float
) -> tuple[float, float]:
    """Integrate one leg by Runge-Kutta 4 for some steps; returns x (m, 0 with relaxed springs) and v (m/s).

    friction: largest force of friction and brake, N. In each step they apply the force that stops the leg by
    the end of the step, limited to `friction`.
    """
    x, v, h = b.x[i] - b.origin[i], b.v[i], b.step_s
    for _ in range(steps):
        f = force
        if friction > 0.0:
            stop = -b.mass[i] * (v / h + _acceleration(b, i, f, damping, x, v))
            f += min(max(stop, -friction), friction)
        a1 = _acceleration(b, i, f, damping, x, v)
        v2 = v + 0.5 * h * a1
        a2 = _acceleration(b, i, f, damping, x + 0.5 * h * v, v2)
        v3 = v + 0.5 * h * a2
        a3 = _acceleration(b, i, f, damping, x + 0.5 * h * v2, v3)
        v4 = v + h * a3
        a4 = _acceleration(b, i, f, damping, x + h * v3, v4)
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
    """Function `move` of `Moved`: returns 0, or NOT_FINITE or DIVERGED with the state unchanged."""
    f, brakes, into = reals_at(force, LEGS), reals_at(brake, LEGS), reals_at(measured, MEASURED)
    if not (_all_finite(f) and _all_finite(brakes) and _all_finite(reals_at(wrench, LEGS))):
        return NOT_FINITE
    x, v = np.empty(LEGS), np.empty(LEGS)
    for i in range(LEGS):
        friction = b.friction[i] + brakes[i] * b.brake[i]
        damping = max(b.damping[i], abs(b.hand[i]) / HAND_m_s**2)
        x[i], v[i] = _advanced(b, i, steps, f[i] + b.hand[i], friction, damping)
        x[i] += b.origin[i]
    if not (_all_finite(x) and _all_finite(v)):
        return DIVERGED
    for i in range(LEGS):
        low, high = b.shortest[i], b.longest[i]
        if b.hand[i] < 0.0:
            low = max(low, b.hand_from[i] - HAND_M)
        if b.hand[i] > 0.0:
            high = min(high, b.hand_from[i] + HAND_M)
        b.v[i] = 0.0 if x[i] < low or x[i] > high else v[i]
        b.x[i] = min(max(x[i], low), high)
        into[i], into[LEGS + i], into[2 * LEGS + i] = b.x[i] + b.rest[i], b.v[i], np.nan
    return 0


class UncoupledLegs(PointedPlant):
    """Plant: m x'' + b x'|x'| + k0 x + k1 x^3 = f per leg, x = length - rest length, within ends of travel.

    Equation: the nonlinear mass-spring-damper of Slotine and Li, Applied Nonlinear Control (1991), chapter 3.
    An engaged brake is dry friction. A wrench has no effect, as there is no platform.

    Mutable state: `legs`, a record of BENCH.
    """

    def __init__(self, step_s: float, **figures: Any) -> None:
        """Create legs from an internal step, s, and fields of BENCH, each one number or (6,).

        An omitted field is 0; without ends of travel x is unbounded.
        """
        self.internal_step_s = step_s
        self.legs = np.zeros((), BENCH)
        for name, value in {"shortest": -np.inf, "longest": np.inf, "step_s": step_s, **figures}.items():
            self.legs[name] = value
        self._start = self.legs.copy()

    def reset(self) -> tuple[Array, Array]:
        """Restore the initial state; return lengths (6,) m and rates (6,) m/s."""
        self.legs[()] = self._start
        return self.legs["x"] + self.legs["rest"], self.legs["v"].copy()

    def _refused(self, status: int, force: Array, brake: Array, wrench: Array, _steps: int) -> PlantError:
        if status == NOT_FINITE:
            return PlantError(f"force {force}, brake {brake}, wrench {wrench}: a value is not finite")
        return PlantError(
            f"the bench diverged under {force} N: stiffness or damping is too large for plant.model."
            f"internal_step_us = {self.internal_step_s * 1e6:g}"
        )

    def moved(self) -> Moved:
        """Addresses of the compiled function of this plant and of its state, for compiled callers."""
        return Moved(_move.address, data_at(self.legs), self._refused, self)


class Bench(UncoupledLegs):
    """Plant: the six legs of section `plant.model`, initially at rest at their rest lengths."""

    def __init__(self, settings: BenchPlant, *_: object) -> None:
        super().__init__(
            settings.internal_step_us / 1e6,
            mass=settings.mass_kg,
            damping=settings.damping_N_s2_m2,
            stiffness=settings.stiffness_N_m,
            hardening=settings.stiffness_N_m3,
            rest=settings.rest_length_m,
            brake=BRAKE_FORCE_N,
        )
