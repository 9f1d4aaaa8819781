"""Exact inverse dynamics control in joint space (control notes, section 6.1.3).

The notes drop the term J_dot twist when they pass from leg to pose accelerations; with it the error
dynamics is linear: E'' + K_D E' + K_P E = 0 for a model that is exact. What the controller believes of
the robot is the model's business (hil.dynamics.Model), not the law's.
"""

from __future__ import annotations

import numpy as np

from hil.compile_cache import INTEGER, MATRIX, VECTOR, kernel
from hil.config import InverseDynamicsSettings, LegSpin
from hil.control.law import per_leg
from hil.dynamics import Model
from hil.geometry import Platform
from hil.kernels.dynamics import joint_idc_kernel
from hil.rotations import rotation_from_vector
from hil.signals import Array, Effort, Reference, State


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
    def build(
        cls, settings: InverseDynamicsSettings, platform: Platform, leg_spin: LegSpin
    ) -> JointInverseDynamics:
        """Make the law and its model from their section of the configuration."""
        w_n = per_leg(settings.wn_rad_s)
        believed = settings.model
        frozen = believed.frozen_at
        model = Model(
            platform,
            believed.variant,
            leg_spin,
            inertia_scale=believed.inertia_scale,
            reflected_mass=believed.reflected_mass_kg,
            viscous=believed.viscous_friction_N_s_m,
            coulomb=believed.coulomb_friction_N,
            sliding_speed=believed.sliding_speed_m_s,
            frozen_at=None
            if frozen is None
            else (
                np.array(frozen.position_m, float),
                rotation_from_vector(np.deg2rad(frozen.rotation_vector_deg)),
            ),
        )
        return cls(model, w_n**2, 2.0 * settings.damping_ratio * w_n)

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        return Effort(
            _tau(
                self.model.constants, self.model.code, self.K_P, self.K_D,
                state.p, state.R, state.twist, state.J, state.q, state.dq,
                reference.q, reference.dq, reference.ddq,
            )
        )  # fmt: skip


@kernel(
    VECTOR, INTEGER, VECTOR, VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR
)
def _tau(
    constants: Array, code: int, K_P: Array, K_D: Array,
    p: Array, R: Array, twist: Array, J: Array, q: Array, dq: Array, q_d: Array, dq_d: Array, ddq_d: Array,
) -> Array:  # fmt: skip
    ddq_star = np.empty(6)
    for i in range(6):
        ddq_star[i] = ddq_d[i] + K_D[i] * (dq_d[i] - dq[i]) + K_P[i] * (q_d[i] - q[i])
    tau: Array = joint_idc_kernel(constants, code, p, R, twist, J, ddq_star, np.zeros(6))
    return tau
