"""The loop as it runs: sampled, held, late. Eigenvalues, gain, phase and delay margin of one axis.

The axis is gain exp(-transport s) / (lag s + 1) / s^2 behind a hold of one period, from demanded
acceleration to position and rate at the instants of measurement: what a linearised robot looks like through
bus, drives and sampling. The controller gives u from y = [e, de] and the loop is closed by e = -position:
its eigenvalues tell whether the sampled loop is stable, exactly and with all delays.
"""

from math import inf
from typing import NamedTuple

import numpy as np

from drivers.arrays import ComplexArray
from drivers.errors import ModelError
from hil.mathematics.linear_system import LinearSystem, lag, static
from hil.stability.sampled_loop import Margins, disturbed, margins, sampled_axis


class Axis(NamedTuple):
    """One axis of a linearised loop."""

    period_s: float
    transport_s: float = 0.0
    """From the instant of measurement to the force that answers it; pure."""
    lag_s: float = 0.0
    """Time constant of the force, first order; 0: none."""
    gain: float = 1.0
    """1 where model and robot agree."""


class Sampled(NamedTuple):
    """A sampled loop."""

    poles: ComplexArray
    """(n,), of z."""
    margins: Margins | None
    """None where the loop is not stable."""
    decay_rate: float
    """1/s, of the slowest mode, -log |z| over the period; below 0 where it grows."""
    peak_gain: float
    """s^2, from a disturbing acceleration, held over each period, to |e|; inf where not stable."""

    @property
    def stable(self) -> bool:
        """Tell whether all modes decay."""
        return bool((np.abs(self.poles) < 1.0).all())


def disturbed_axis(axis: Axis) -> LinearSystem:
    """Return the axis from u[k] and a disturbing acceleration d[k], both held, to position and rate."""
    return disturbed(sampled_axis(axis.transport_s, lag(axis.lag_s), axis.period_s, axis.gain))


def gains(K_P: float, K_D: float, period_s: float) -> LinearSystem:
    """Return u = K_P e + K_D de as a controller."""
    return static(np.array([[K_P, K_D]]), period_s)


def analyse(axis: Axis, controller: LinearSystem) -> Sampled:
    """Return what the loop of axis and controller is like; the controller takes [e, de] and gives u.

    Raises ModelError where the controller is none for [e, de] or of another period.
    """
    if controller.D.shape != (1, 2):
        raise ModelError(
            f"a controller of {controller.D.shape[1]} inputs and {controller.D.shape[0]} outputs,"
            " allowed: from [e, de] to u"
        )
    plant = disturbed_axis(axis)
    loop = _closed(plant, controller)
    poles = loop.poles()
    radius = float(np.abs(poles).max())
    if radius >= 1.0:
        return Sampled(poles, None, -np.log(radius) / axis.period_s, inf)
    opened = controller.after(plant._replace(B=plant.B[:, :1], D=plant.D[:, :1]))
    return Sampled(poles, margins(opened), -np.log(max(radius, 1e-300)) / axis.period_s, _peak_gain(loop))


def _closed(plant: LinearSystem, controller: LinearSystem) -> LinearSystem:
    """Return the loop from d to e: y = [e, de] = -[position, rate]."""
    A, B, C, D, T = plant
    zero = np.zeros((1, 1))
    # Inputs d, u; outputs e, and [e, de] for the controller.
    swapped = B[:, [1, 0]]
    return LinearSystem(
        A, swapped, np.vstack([-C[:1], -C]), np.vstack([np.hstack([zero, zero]), D]), T
    ).closed_with(controller)


def _peak_gain(loop: LinearSystem) -> float:
    """Return the sum of |h[k]| of a stable loop from d to e, to a ten thousandth."""
    x, total = loop.B[:, :1], 0.0
    slowest = -np.log(max(np.abs(loop.poles()).max(), 1e-300))
    steps = min(200_000, int(np.ceil(12.0 / slowest)) + len(x))
    A, C = loop.A, loop.C[:1]
    for _ in range(steps):
        total += abs((C @ x).item())
        x = A @ x
    return total
