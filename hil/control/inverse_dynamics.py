"""Exact inverse dynamics control in joint space (control notes, section 6.1.3).

The notes omit the term J_dot twist in the conversion from leg to pose accelerations. With this term and an
exact model the error dynamics are linear: E'' + K_D E' + K_P E = 0. Model simplifications belong to
`hil.robot.dynamics.Model`, not to the law.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import pointed, reals_at
from drivers.tick_columns import Record
from hil.control.law import ErrorGains, LawContext, ModelBasedSettings
from hil.control.pointed_law import SEEN, PointedLaw
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, joint_idc_kernel

GAINS = np.dtype([("K_P", "<f8", 6), ("K_D", "<f8", 6), ("loaded", "<i8")])
"""Layout of the gains: diagonals; loaded: 1 if the law compensates the external wrench."""


class InverseDynamicsSettings(ErrorGains, ModelBasedSettings):
    """Inverse dynamics control in joint space; exact with model variant `full`, else approximate."""

    law: Literal["inverse_dynamics"]

    def build(self, context: LawContext) -> JointInverseDynamics:
        """Build the control law from these settings."""
        return JointInverseDynamics(context.model(self.model), *self.gains())


@helper
def linearise(constants: int, code: int, tick: Any, ddq_star: Array, wrench: Array) -> None:
    """Fill tau_law (6,) N of a tick so that the model's legs accelerate by ddq*; NaN where J is singular."""
    c = reals_at(constants, SIZE)
    tick.tau_law[:] = joint_idc_kernel(c, code, tick.p, tick.R, tick.twist, tick.J, ddq_star, wrench)


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    ddq_star, wrench = np.empty(6), np.zeros(6)
    for i in range(6):
        e, de = tick.q_d[i] - tick.q[i], tick.dq_d[i] - tick.dq[i]
        ddq_star[i] = tick.ddq_d[i] + k.K_D[i] * de + k.K_P[i] * e
        if k.loaded:
            wrench[i] = tick.wrench[i]
    linearise(constants, code, tick, ddq_star, wrench)
    return 0


class JointInverseDynamics(PointedLaw):
    """tau = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction, ddq* = ddq_d + K_D dE + K_P E.

    E = q_d - q (6,) m; K_P (6,) 1/s^2 and K_D (6,) 1/s are the diagonals. Friction is evaluated at the
    measured leg rates. tau is NaN where J is singular.
    """

    dtype = GAINS
    fill = _fill
    compensates_wrench: ClassVar[bool] = True
    """True if the law compensates the external wrench; otherwise it assumes wrench = 0."""

    def __init__(self, model: Model, K_P: Array, K_D: Array) -> None:
        super().__init__(model, K_P, K_D, self.compensates_wrench)


def linearising_tau(model: Model, tick: Record, ddq_star: Array) -> Array:
    """Leg forces (6,) N that accelerate the model's legs by ddq* (6,) m/s^2; NaN where J is singular."""
    return joint_idc_kernel(
        model.constants, model.code, tick["p"], tick["R"], tick["twist"], tick["J"], ddq_star, tick["wrench"]
    )
