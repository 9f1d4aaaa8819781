"""PD on the platform's pose (control notes, section 6.1, topology a: direct kinematics in the loop)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import VECTOR, kernel
from hil.config import CartesianPDSettings
from hil.control.law import LawContext, per_axis
from hil.control.model import build_model
from hil.mathematics.linear_algebra import solve_transposed
from hil.mathematics.rotations import relative_rotation, rotation_vector_kernel
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.signals import Effort, Reference, State

_REST = np.zeros(6)
_REST.flags.writeable = False


def _vector_difference(R: Array, R_d: Array) -> Array:
    """Return phi_d - phi (3,) rad, phi the rotation vector of the pose."""
    return rotation_vector_kernel(R_d) - rotation_vector_kernel(R)


ROTATION_ERRORS = {"shortest_turn": relative_rotation, "vector_difference": _vector_difference}
"""`controller.rotation_error` of the configuration -> function of R and R_d, (3,) rad."""


class CartesianPD:
    """tau = J^-T [K_p e + K_v (twist_d - twist) + G], e = [p_d - p; e_R], G only with a model.

    K_p and K_v are diagonal in the base frame. ``shortest_turn``: e_R = log(R_d R^T), the rotation vector
    (base frame) of the shortest turn from R to R_d: no Euler angles, no other singularity than half a turn
    between the two. For a reference at rest, an exact G and one K_p for all three rotations, V = kinetic
    energy + e.K_p e / 2 falls by twist.K_v twist (Bullo and Murray, 1995); with three different ones that
    holds to first order in e.

    ``vector_difference``, for comparison: the often printed e_R = phi_d - phi, phi the rotation vector of the
    pose itself. It is another law wherever the platform is turned: its stiffness is K_p times the inverse of
    d omega / d phi', which is not symmetric, so that no energy belongs to it; and it jumps where the platform
    itself is turned by half a turn.

    No mutable state.
    """

    def __init__(
        self, K_p: Array, K_v: Array, model: Model | None, rotation_error: Callable[[Array, Array], Array]
    ) -> None:
        """K_p (6,) N/m, N m/rad and K_v (6,) N s/m, N m s/rad are the diagonals, position first."""
        self.K_p = K_p
        self.K_v = K_v
        self.model = model
        self.rotation_error = rotation_error

    @classmethod
    def build(cls, settings: CartesianPDSettings, context: LawContext) -> CartesianPD:
        """Make the law and its model, if any, from their section of the configuration."""
        model = settings.model
        return cls(
            per_axis(settings.kp_position_N_m, settings.kp_rotation_N_m_rad),
            per_axis(settings.kv_position_N_s_m, settings.kv_rotation_N_m_s_rad),
            None if model is None else build_model(model, context.platform, context.leg_spin),
            ROTATION_ERRORS[settings.rotation_error],
        )

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        del shortfall
        e_R = self.rotation_error(state.R, reference.R)
        pull = _pull(self.K_p, self.K_v, e_R, state.p, state.twist, reference.p, reference.twist)
        model = self.model
        if model is None:
            return Effort(solve_transposed(state.J, pull))
        return Effort(
            inverse_dynamics_kernel(model.constants, model.code, state.p, state.R, _REST, _REST, -pull)
        )


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def _pull(K_p: Array, K_v: Array, e_R: Array, p: Array, twist: Array, p_d: Array, twist_d: Array) -> Array:
    """Return K_p e + K_v (twist_d - twist), (6,) N, N m, base frame."""
    wrench = np.empty(6)
    for i in range(3):
        wrench[i] = K_p[i] * (p_d[i] - p[i]) + K_v[i] * (twist_d[i] - twist[i])
        wrench[3 + i] = K_p[3 + i] * e_R[i] + K_v[3 + i] * (twist_d[3 + i] - twist[3 + i])
    return wrench
