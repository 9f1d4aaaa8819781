"""The loop as it runs: sampled, held, late. Eigenvalues, gain, phase and delay margin of one axis.

The axis is gain exp(-transport s) / (lag s + 1) / s^2 behind a hold of one period, from demanded
acceleration to position and rate at the instants of measurement: what a linearised robot looks like through
bus, drives and sampling. The controller gives u from y = [e, de] and the loop is closed by e = -position:
its eigenvalues tell whether the sampled loop is stable, exactly and with all delays.
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.design.stability.sampled_loop import Margins, disturbed, margins, sampled_axis
from hil.mathematics.linear_system import LinearSystem, lag, static


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
    loop: LinearSystem
    """To e, de and u from a disturbing acceleration, held over each period, and from what e and de are
    measured wrong by at each sample."""

    @property
    def largest(self) -> float:
        """The largest |z|."""
        return float(np.abs(self.poles).max())

    @property
    def stable(self) -> bool:
        """Tell whether all modes decay."""
        return bool((np.abs(self.poles) < 1.0).all())

    @property
    def peak_gain(self) -> float:
        """s^2, from a disturbing acceleration to |e|; inf where not stable."""
        return float(self.peak_gains()[0])

    def peak_gains(self, slope: float = 0.0) -> Array:
        """Return the peak gains (4,) to |e| s^2, |de| s, |u| and |de + slope e| s, at each measurement.

        Of every acceleration within its bound, whenever it changes: h(s), its weight a time s before a
        measurement, is linear in s over each period, so that its area is known. inf where not stable.
        """
        if not self.stable:
            return np.full(4, inf)
        T = self.loop.period_s
        assert T is not None
        x = np.zeros((len(self.poles), 2))  # after a period at whose beginning, and end, an impulse acted
        x[0, 0], x[1] = T, 1.0
        h = _rows(slope) @ self._answers(x)
        first, last = np.moveaxis(np.abs(h), 2, 0)
        both, same = first + last, h[..., 0] * h[..., 1] >= 0.0
        area = np.where(same, both / 2.0, (first**2 + last**2) / (2.0 * np.where(same, 1.0, both)))
        return np.asarray(T * area.sum(axis=0), float)

    def impulse_responses(self) -> Array:
        """Return what e, de and u (n, 3) are at the samples after d = 1 for one period."""
        return np.asarray(self._answers(self.loop.B[:, :1])[..., 0], float)

    def measured_gains(self, slope: float = 0.0, *, rate: bool = False) -> Array:
        """Return the peak gains (4,) to |e|, |de|, |u|, |de + slope e| from what e is measured wrong by.

        rate: from what de is measured wrong by.
        """
        k = 1 + rate
        through = self.loop.D[:, k : k + 1]
        h = _rows(slope) @ np.concatenate([through[None], self._answers(self.loop.B[:, k : k + 1])])
        return np.asarray(np.abs(h[..., 0]).sum(axis=0), float)

    def _answers(self, x: Array) -> Array:
        """Return e, de and u (n, 3, m) at the samples from states x (order, m) on, until forgotten."""
        found = []
        for _ in range(self.steps):
            found.append(self.loop.C @ x)
            x = self.loop.A @ x
        return np.array(found)

    @property
    def steps(self) -> int:
        """Periods after which a stable loop has forgotten an impulse, to a hundred thousandth."""
        slowest = -np.log(max(np.abs(self.poles).max(), 1e-300))
        return min(200_000, int(np.ceil(12.0 / slowest)) + len(self.poles))


def _rows(slope: float) -> Array:
    """Return e, de, u and de + slope e of e, de and u."""
    return np.vstack([np.eye(3), [slope, 1.0, 0.0]])


def of_each(loops: Sequence[Sampled], figures: Callable[[Sampled], Array]) -> list[Array]:
    """Return the figures of each loop; of axes that share one loop they are worked out once."""
    found = {id(loop): figures(loop) for loop in {id(loop): loop for loop in loops}.values()}
    return [found[id(loop)] for loop in loops]


def disturbed_axis(axis: Axis) -> LinearSystem:
    """Return the axis from u[k] and a disturbing acceleration d[k], both held, to position and rate."""
    return disturbed(sampled_axis(axis.transport_s, lag(axis.lag_s), axis.period_s, axis.gain))


def gains(K_P: float, K_D: float, period_s: float) -> LinearSystem:
    """Return u = K_P e + K_D de as a controller."""
    return static(np.array([[K_P, K_D]]), period_s)


def analyse(axis: Axis, controller: LinearSystem) -> Sampled:
    """Return what the loop of axis and controller is like; the controller takes [e, de] and gives u.

    Raises ModelError where the controller is of another period.
    """
    plant = disturbed_axis(axis)
    loop = _closed(plant, controller)
    poles = loop.poles()
    radius = float(np.abs(poles).max())
    decay = -np.log(max(radius, 1e-300)) / axis.period_s
    if radius >= 1.0:
        return Sampled(poles, None, decay, loop)
    opened = controller.after(plant._replace(B=plant.B[:, :1], D=plant.D[:, :1]))
    return Sampled(poles, margins(opened), decay, loop)


def _closed(plant: LinearSystem, controller: LinearSystem) -> LinearSystem:
    """Return the loop from d, n and m to e, de and u: y = [e + n, de + m], e = -position."""
    A, B, C, _, T = plant
    # Inputs d, n, m, u; outputs e, de, u, and y for the controller.
    inputs = np.column_stack([B[:, 1], np.zeros((len(A), 2)), B[:, 0]])
    outputs = np.vstack([-C, np.zeros((1, len(A))), -C])
    through = np.zeros((5, 4))
    through[2, 3] = through[3, 1] = through[4, 2] = 1.0
    return LinearSystem(A, inputs, outputs, through, T).closed_with(controller)
