"""The leg forces of a log as linear equations in the platform's ten parameters and the drives' friction.

tau - legs = J^-T Y theta + viscous dq + coulomb sgn(dq) + reflected ddq - late dtau/dt, a row for each leg
and sample: the part of the legs, their weight included, is the model's.

Forces and lengths are not of one instant: drives report what acted some 10 us before or after the latch, and
what is known of the delay of a command may be off by half a period. An inertia that is looked at too late
looks like viscous friction, so the time is an unknown, too: tau(t) = acting(t - late), to first order.

Both sides go through one filter and are thinned out (M. Gautier, Proc. IEEE ICRA 1997). A leg that is slow or
turns back under the filter gives no row: what sticks hides any force.
"""

from typing import NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array, Flags, Ints
from hil.lab.identify.estimators.leg_motion import (
    LegSignals,
    PlatformMotion,
    all_under,
    bell,
    half_ticks,
    platform_motion,
    reading_errors,
    smooth,
)
from hil.lab.identify.estimators.rigid_body import SIZE, regressor
from hil.robot import dynamics_kernels as kernels
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform

VISCOUS, COULOMB, REFLECTED = SIZE, SIZE + 6, SIZE + 13
"""First columns of the drives' parts, one column a leg; the platform's ten stand before."""
LATE = SIZE + 12
"""Column of the time by which the forces are late, common to all legs."""
COLUMNS = SIZE + 19
WIDER = 3
"""Times the filter of the lengths: that of both sides, which costs nothing but noise."""


class Equations(NamedTuple):
    """A theta = y, row by row in the order of time; sum over logs by `joined`."""

    A: Array
    """(m, 29): ten parameters of the platform; viscous and coulomb friction of each leg; the time by which
    forces are late, s; reflected mass of each leg."""
    y: Array
    """(m,) N."""
    noise: Array
    """(m, 29): what A changes by where each length is read with one more error of its own size."""
    leg: Ints
    """(m,) 0..5."""
    sample: Ints
    """(m,): the instant, counted over all logs; rows of one instant are neighbours."""

    def part(self, which: Flags) -> "Equations":
        """Return some of the rows."""
        return Equations(self.A[which], self.y[which], self.noise[which], self.leg[which], self.sample[which])


def equations_of(model: Model, signals: LegSignals) -> Equations:
    """Return what a log says of platform and drives.

    Of the model legs, joints, gravity and sliding speed count, neither other masses nor friction.
    """
    motion = platform_motion(model.platform, signals)
    c = model.constants.copy()
    c[kernels.MASS] = c[kernels.VISCOUS] = 0.0
    c[kernels.COM : kernels.INERTIA + 9] = 0.0
    c[kernels.REFLECTED : kernels.REFLECTED + 6] = 0.0
    c[kernels.VISCOUS : kernels.COULOMB + 6] = 0.0
    needed = motion.force.copy()
    for k in np.flatnonzero(motion.good):
        needed[k] -= kernels.inverse_dynamics_kernel(
            c, kernels.FULL, motion.p[k], motion.R[k], motion.twist[k], motion.dtwist[k], ZERO6
        )
    half = half_ticks(signals.period_s)
    wide = bell(WIDER * half, signals.period_s)
    fast = np.abs(motion.dq) > max(float(c[kernels.SLIDING_SPEED]), 1e-6)
    one_way = all_under(wide.half, fast & (motion.dq > 0.0)) | all_under(wide.half, fast & (motion.dq < 0.0))
    usable = one_way & all_under(wide.half, motion.good)[:, None]
    usable &= (np.arange(len(needed)) % half == 0)[:, None]
    error = np.random.default_rng(0).standard_normal(signals.length.shape)  # the same for the same log
    again = signals._replace(length=signals.length + reading_errors(signals) * error)
    A, B = (
        smooth(wide.value, x.reshape(len(x), -1)).reshape(x.shape)
        for x in (_columns(model.platform, m) for m in (motion, platform_motion(model.platform, again)))
    )
    at, legs = np.nonzero(usable)
    return Equations(
        A[at, legs], smooth(wide.value, needed)[at, legs], B[at, legs] - A[at, legs],
        legs.astype(np.int64), at.astype(np.int64),
    )  # fmt: skip


def _columns(platform: Platform, motion: PlatformMotion) -> Array:
    """Return A (n, 6, 29) at every tick."""
    A = np.zeros((len(motion.p), 6, COLUMNS))
    Y = regressor(motion.R, motion.twist, motion.dtwist, platform.gravity)
    A[:, :, :SIZE] = np.linalg.solve(motion.J.transpose(0, 2, 1), Y)
    for leg in range(6):
        A[:, leg, VISCOUS + leg] = motion.dq[:, leg]
        A[:, leg, COULOMB + leg] = np.sign(motion.dq[:, leg])
        A[:, leg, LATE] = -motion.dforce[:, leg]
        A[:, leg, REFLECTED + leg] = motion.ddq[:, leg]
    return A


def without(equations: Equations, given: Array, first: int) -> Equations:
    """Return the equations with the unknowns from `first` on known, given (29,): their columns are 0."""
    A, noise = equations.A.copy(), equations.noise.copy()
    A[:, first:] = noise[:, first:] = 0.0
    return equations._replace(A=A, y=equations.y - equations.A[:, first:] @ given[first:], noise=noise)


def joined(logs: list[Equations]) -> Equations:
    """Return the equations of several logs as one system."""
    begun, samples = 0, []
    for each in logs:
        samples.append(each.sample + begun)
        begun += int(each.sample.max(initial=-1)) + 1
    A, y, noise, leg = (np.concatenate([each[k] for each in logs]) for k in range(4))
    return Equations(A, y, noise, leg, np.concatenate(samples))
