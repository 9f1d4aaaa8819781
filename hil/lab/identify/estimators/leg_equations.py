"""The leg forces of a log as linear equations in the platform's ten parameters and the drives' friction.

tau - legs = J^-T Y theta + viscous dq + coulomb sgn(dq) + reflected ddq - late dtau/dt, a row for each leg
and sample. With load cells between drives and rods there are two rows instead, each with its own unknowns:
cell - legs = J^-T Y theta; tau - cell = viscous dq + coulomb sgn(dq) + reflected ddq - late dtau/dt.
`legs` are the forces of the legs themselves, with their weight, from the model.

Forces and lengths are not simultaneous: drives report forces from some 10 us before or after they sample the
encoder, and the known delay of a command may be off by half a period. An inertia evaluated too late looks
like viscous friction, so this time is an unknown, too: tau(t) = acting(t - late), to first order.

Both sides go through one filter and are decimated (M. Gautier, Proc. IEEE ICRA 1997). A leg that is slow or
reverses under the filter gives no row, since a leg that sticks hides any force.

Regressors contain the encoders' errors, and so does the force, through the law. Instruments are the
regressors along the reference, which is free of both errors (A. Janot, P.-O. Vandanjon and M. Gautier, IEEE
Trans. Control Syst. Technol. 22(1), 2014).
"""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array, Flags, Ints
from hil.lab.identify.estimators.leg_motion import (
    LegSignals,
    PlatformMotion,
    all_under,
    bell,
    half_ticks,
    platform_motion,
    smooth,
)
from hil.lab.identify.estimators.rigid_body import SIZE, regressor
from hil.robot import dynamics_kernels as kernels
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform

VISCOUS, COULOMB, REFLECTED = SIZE, SIZE + 6, SIZE + 13
"""First columns of the drives' parameters, one column per leg; the platform's ten come first."""
LATE = SIZE + 12
"""Column of the common delay of the forces."""
COLUMNS = SIZE + 19
WIDER = 3
"""Width of the filter of both sides, as a multiple of the lengths' filter; it reduces noise without bias."""


class Equations(NamedTuple):
    """Linear equations A theta = y, N, of the legs, rows in time order; `joined` appends several logs."""

    A: Array
    """(m, 29): ten parameters of the platform; viscous and Coulomb friction of each leg; common delay of the
    forces, s; reflected mass of each leg.
    """
    y: Array
    """(m,) N, leg force less the legs' own forces."""
    instruments: Array
    """(m, 29): A computed along the reference, as instruments."""
    leg: Ints
    """(m,) leg number, 0 to 5; 6 more for the drive of a leg with a load cell."""
    sample: Ints
    """(m,): index of the instant over all logs; rows of one instant are neighbours."""

    def part(self, which: Flags) -> "Equations":
        """Equations of the selected rows; which: mask (m,)."""
        parts: list[Any] = [each[which] for each in self]
        return Equations(*parts)


def equations_of(model: Model, signals: LegSignals) -> Equations:
    """Leg equations of a log for the parameters of platform and drives.

    The model contributes legs, joints, gravity and sliding speed, but no other masses and no friction.
    """
    motion = platform_motion(model.platform, signals)
    reference = platform_motion(model.platform, signals._replace(length=signals.reference))
    led = _forces(model.constants, reference)
    reference = reference._replace(dforce=np.gradient(led, signals.period_s, axis=0))
    c = model.constants.copy()
    c[kernels.MASS] = c[kernels.VISCOUS] = 0.0
    c[kernels.COM : kernels.INERTIA + 9] = 0.0
    c[kernels.REFLECTED : kernels.REFLECTED + 6] = 0.0
    c[kernels.VISCOUS : kernels.COULOMB + 6] = 0.0
    own = _forces(c, motion)
    half = half_ticks(signals.period_s)
    wide = bell(WIDER * half, signals.period_s)
    fast = np.abs(motion.dq) > max(float(c[kernels.SLIDING_SPEED]), 1e-6)
    one_way = all_under(wide.half, fast & (motion.dq > 0.0)) | all_under(wide.half, fast & (motion.dq < 0.0))
    usable = one_way & all_under(wide.half, motion.good & reference.good)[:, None]
    usable &= (np.arange(len(own)) % half == 0)[:, None]
    A, W = (
        smooth(wide.value, x.reshape(len(x), -1)).reshape(x.shape)
        for x in (_columns(model.platform, m) for m in (motion, reference))
    )
    at, legs = np.nonzero(usable)

    def rows(y: Array, unknowns: slice, group: int) -> Equations:
        kept = np.zeros(COLUMNS)
        kept[unknowns] = 1.0
        leg = legs.astype(np.int64) + group
        smoothed = smooth(wide.value, y)[at, legs]
        return Equations(A[at, legs] * kept, smoothed, W[at, legs] * kept, leg, at.astype(np.int64))

    if signals.cells is None:
        return rows(motion.force - own, slice(None), 0)
    measured = np.where(signals.good[:, None], signals.cells, 0.0)
    cells = smooth(bell(half, signals.period_s).value, measured)
    parts = rows(cells - own, slice(SIZE), 0), rows(motion.force - cells, slice(SIZE, None), 6)
    return Equations(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _forces(constants: Array, motion: PlatformMotion) -> Array:
    """Leg forces (n, 6) N of the model along a motion."""
    found = np.zeros_like(motion.force)
    for k in np.flatnonzero(motion.good):
        found[k] = kernels.inverse_dynamics_kernel(
            constants, kernels.FULL, motion.p[k], motion.R[k], motion.twist[k], motion.dtwist[k], ZERO6
        )
    return found


def _columns(platform: Platform, motion: PlatformMotion) -> Array:
    """Regressors A (n, 6, 29) of every tick and leg."""
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
    """Equations with the unknowns from column `first` on fixed at `given` (29,): their columns become 0."""
    A, W = equations.A.copy(), equations.instruments.copy()
    A[:, first:] = W[:, first:] = 0.0
    return equations._replace(A=A, y=equations.y - equations.A[:, first:] @ given[first:], instruments=W)


def joined(logs: list[Equations]) -> Equations:
    """The equations of several logs as one system."""
    begun = np.cumsum([0, *(int(each.sample.max(initial=-1)) + 1 for each in logs)])
    logs = [each._replace(sample=each.sample + first) for each, first in zip(logs, begun[:-1], strict=True)]
    return Equations(*(np.concatenate(parts) for parts in zip(*logs, strict=True)))
