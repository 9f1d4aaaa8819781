"""The Plant protocol: physics of a machine with six leg forces as inputs."""

import ctypes
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from drivers.errors import PlantError

_MOVE = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 6)
"""Type of `Moved.move`."""
MEASURED = 18
"""Number of values that it fills in."""


class Truth(NamedTuple):
    """True pose and forces of the platform, for the plant's log; the controller does not see them."""

    p: Array
    """Platform origin (3,) m in the base frame."""
    R: Array
    """Rotation (3, 3), platform to base."""
    twist: Array
    """(6,) m/s and rad/s, [v of the platform origin; omega], base frame."""
    applied_force: Array
    """(6,) N, forces after the drives' force lag, without friction."""


def truth_of(y: Array) -> Truth:
    """Truth from y (24,): p (3,) m, R (9,) row-major, twist (6,), applied forces (6,) N."""
    return Truth(y[:3], y[3:12].reshape(3, 3), y[12:18], y[18:])


class Robot(NamedTuple):
    """A platform with its legs, and its initial pose; it starts at rest."""

    platform: Mapping[str, Any]
    """base_joints (6, 3) m, platform_joints (6, 3) m, platform {mass, com, inertia}, cylinder and rod
    {mass, com, inertia_axial, inertia_transverse}, gravity (3,), optional leg_spin and
    universal_joint_base_axes (6, 3); SI."""
    length_min: Array
    """Leg lengths (6,) m at an end of the stroke."""
    length_max: Array
    """Leg lengths (6,) m at an end of the stroke."""
    p0: Array
    """Platform origin (3,) m in the base frame."""
    R0: Array
    """Rotation (3, 3), platform to base."""


def whole_steps(dt_s: float, step_s: float) -> int:
    """`dt_s` in internal steps. Raises PlantError unless it is a multiple (1e-9 relative)."""
    n = round(dt_s / step_s) if 0.0 < dt_s < 1e9 * step_s else 0
    if n < 1 or abs(dt_s - n * step_s) > 1e-9 * dt_s:
        raise PlantError(f"a step of {dt_s!r} s is not a multiple of the plant's step of {step_s!r} s")
    return n


class Moved(NamedTuple):
    """A plant as compiled code calls it: address of a function, and its first argument `context`.

    A compiled plant returns it from `moved()`.
    """

    move: int
    """(context, force, brake, wrench, steps, measured) -> 0 or a reason for refusal. All arguments but steps
    are addresses. Holds the inputs (6,) for some internal steps and fills in (18,): lengths, rates and
    applied forces N, or NaN if they are unknown."""
    context: int
    refused: Callable[[int, Array, Array, Array, int], BaseException]
    """Error for a status of `move`; arguments: status, force, brake, wrench, steps."""
    keeps: Any
    """Objects that have to stay in memory."""


class Plant(Protocol):
    """Physics of six legs with six force inputs; by default the true pose is unknown, `close` does nothing.

    Mutable state: the physics. `reset` restores the initial state exactly.
    """

    internal_step_s: float
    """Internal step; every `dt_s` given to `step` is a whole multiple of it."""

    def reset(self) -> tuple[Array, Array]:
        """Restore the initial state; returns leg lengths (6,) m and rates (6,) m/s."""

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Hold the inputs for `dt_s` s; returns leg lengths (6,) m and rates (6,) m/s at its end.

        force (6,) N commanded, > 0 extends; brake (6,) 1 engaged, 0 released;
        wrench (6,) N, N m on the platform at its origin, base frame.
        Raises PlantError on a dt that is not a multiple of the internal step or a non-finite input.
        """

    def truth(self) -> Truth | None:
        """True pose, twist and applied forces now; None for a plant without a platform."""
        return None

    def rod_force(self) -> Array | None:
        """Forces (6,) N between drives and rods of the legs, as load cells measure; None: unknown."""
        return None

    def notes(self) -> list[str]:
        """Warnings and other reports of the plant since it was opened, one sentence each."""
        return []

    def close(self) -> None:
        """Free the plant's resources, such as a loaded FMU."""
        return


class PointedPlant(Plant):
    """A plant that compiled code calls by address. Mutable state: its physics, in the memory of `moved()`."""

    def moved(self) -> Moved:
        """Addresses of the compiled function of this plant and of its state, for compiled callers."""
        raise NotImplementedError

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Step as `Plant.step`, by calling the compiled function of `moved()`."""
        n, moved, values = whole_steps(dt_s, self.internal_step_s), self.moved(), np.empty(MEASURED + 18)
        inputs = values[MEASURED:]
        inputs[:6], inputs[6:12], inputs[12:] = force, brake, wrench
        at = values.ctypes.data
        forces = at + 8 * MEASURED
        status = _MOVE(moved.move)(moved.context, forces, forces + 8 * 6, forces + 8 * 12, n, at)
        if status:
            raise moved.refused(status, force, brake, wrench, n)
        return values[:6], values[6:12]
