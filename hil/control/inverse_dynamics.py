"""Exact inverse dynamics control in joint space (control notes, section 6.1.3).

The notes drop the term J_dot twist when they pass from leg to pose accelerations; with it the error
dynamics is linear: E'' + K_D E' + K_P E = 0 for a model that is exact. What the controller believes of
the robot is the model's business (hil.robot.dynamics.Model), not the law's.
"""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, OUT_VECTOR, VECTOR, direct
from drivers.signals import LEGS
from hil.config import InverseDynamicsSettings
from hil.control.law import LawContext, error_gains
from hil.control.model import build_model
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import joint_idc_kernel
from hil.signal_types import REFERENCE, STATE
from hil.signals import Effort, Reference, State


class JointInverseDynamics:
    """tau = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction, ddq* = ddq_d + K_D dE + K_P E.

    E = q_d - q (6,) m. Friction is that of the measured rates. No mutable state.
    """

    def __init__(self, model: Model, K_P: Array, K_D: Array) -> None:
        """K_P (6,) 1/s^2 and K_D (6,) 1/s are the diagonals."""
        self.model = model
        self.K_P = K_P
        self.K_D = K_D

    @classmethod
    def build(cls, settings: InverseDynamicsSettings, context: LawContext) -> JointInverseDynamics:
        """Make the law and its model from their section of the configuration."""
        model = build_model(settings.model, context.platform, context.leg_spin)
        return cls(model, *error_gains(settings.wn_rad_s, settings.damping_ratio))

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        del shortfall
        return Effort(linearised_pd(self.model, self.K_P, self.K_D, state, reference))


def linearised_pd(model: Model, K_P: Array, K_D: Array, state: State, reference: Reference) -> Array:
    """Return tau (6,) N for ddq* = ddq_d + K_D dE + K_P E (6,) m/s^2; NaN where J is singular."""
    tau = np.empty(LEGS)
    _linearised_pd(K_P, K_D, model.constants, model.code, *state, *reference, tau)
    return tau


def linearising_tau(model: Model, state: State, ddq_star: Array, wrench: Array) -> Array:
    """Return tau (6,) N for ddq* (6,) m/s^2 with what the model's variant keeps; NaN where J is singular."""
    return joint_idc_kernel(
        model.constants, model.code, state.p, state.R, state.twist, state.J, ddq_star, wrench
    )


@direct(VECTOR, VECTOR, VECTOR, INTEGER, *STATE, *REFERENCE, OUT_VECTOR)
def _linearised_pd(
    K_P: Array, K_D: Array, c: Array, code: int,
    q: Array, dq: Array, p: Array, R: Array, twist: Array, J: Array, _iterations: int, _residual: float,
    wrench: Array,
    _p_d: Array, _R_d: Array, _twist_d: Array, _dtwist_d: Array, q_d: Array, dq_d: Array, ddq_d: Array,
    _t: float, tau: Array,
) -> None:  # fmt: skip
    ddq_star = np.empty(6)
    for i in range(6):
        ddq_star[i] = ddq_d[i] + K_D[i] * (dq_d[i] - dq[i]) + K_P[i] * (q_d[i] - q[i])
    tau[:] = joint_idc_kernel(c, code, p, R, twist, J, ddq_star, wrench)
