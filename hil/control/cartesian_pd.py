"""PD on the platform's pose (control notes, section 6.1, topology a: forward kinematics in the loop)."""

from __future__ import annotations

from math import sqrt
from typing import Any, Literal

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed, reals_at
from drivers.rotations import rotation_vector_kernel
from hil.config.model import ModelSettings
from hil.config.values import Positive, ThreePositive
from hil.control.law import DesiredLoop, LawContext, LawSettings, per_axis
from hil.control.pointed_law import SEEN, PointedLaw
from hil.mathematics.linear_algebra import solve_transposed
from hil.mathematics.rotations import relative_rotation
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, inverse_dynamics_kernel

RotationError = Literal["shortest_turn", "vector_difference"]
GAINS = np.dtype([("K_p", "<f8", 6), ("K_v", "<f8", 6), ("vector_difference", "<i8")])
"""Layout of the gains: diagonals; 1: rotation error by vector difference, 0: by shortest turn."""


class CartesianPDSettings(LawSettings):
    """PD control of the platform's position and rotation; forward kinematics gives the measured pose."""

    uncertified = "its energy function decreases only for a reference at rest; in motion it may grow"
    knob = {
        "kp_position_N_m": 2,
        "kv_position_N_s_m": 1,
        "kp_rotation_N_m_rad": 2,
        "kv_rotation_N_m_s_rad": 1,
    }
    law: Literal["cartesian_pd"]
    kp_position_N_m: Positive | ThreePositive
    """Gains: one number for all three axes of the base frame, or one per axis."""
    kv_position_N_s_m: Positive | ThreePositive
    kp_rotation_N_m_rad: Positive | ThreePositive
    kv_rotation_N_m_s_rad: Positive | ThreePositive
    rotation_error: RotationError = "shortest_turn"
    """log(R_d R^T), or the often printed difference of the rotation vectors of the two poses."""
    model: ModelSettings | None = None
    """Model for gravity compensation; default: no compensation."""

    @property
    def believed(self) -> ModelSettings | None:
        """Settings of the model for gravity compensation; None without compensation."""
        return self.model

    def gains(self) -> tuple[Array, Array]:
        """Diagonal gains K_p (6,) N/m, N m/rad and K_v (6,) N s/m, N m s/rad, position first."""
        return (
            per_axis(self.kp_position_N_m, self.kp_rotation_N_m_rad),
            per_axis(self.kv_position_N_s_m, self.kv_rotation_N_m_s_rad),
        )

    def build(self, context: LawContext) -> CartesianPD:
        """Build the control law from these settings."""
        model = None if self.model is None else context.model(self.model)
        return CartesianPD(*self.gains(), model, self.rotation_error)

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float]:
        """Natural frequency, rad/s, and damping ratio of a translation of `mass` kg at the largest gains."""
        del leg_mass
        wn = sqrt(np.max(self.kp_position_N_m) / mass)
        return wn, float(np.max(self.kv_position_N_s_m) / (2.0 * wn * mass))

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Gains that give the heaviest translation and rotation the desired wn and zeta."""
        stiffness, damping = loop.wn**2, 2.0 * loop.zeta * loop.wn
        return {
            "kp_position_N_m": loop.mass * stiffness,
            "kv_position_N_s_m": loop.mass * damping,
            "kp_rotation_N_m_rad": loop.inertia * stiffness,
            "kv_rotation_N_m_s_rad": loop.inertia * damping,
        }


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    e_R = relative_rotation(tick.R, tick.R_d)
    if k.vector_difference:
        phi, phi_d = rotation_vector_kernel(tick.R), rotation_vector_kernel(tick.R_d)
        for i in range(3):
            e_R[i] = phi_d[i] - phi[i]
    pull, load, rest = np.empty(6), np.empty(6), np.zeros(6)
    for i in range(6):
        e = tick.p_d[i] - tick.p[i] if i < 3 else e_R[i - 3]
        pull[i] = k.K_p[i] * e + k.K_v[i] * (tick.twist_d[i] - tick.twist[i])
        load[i] = -pull[i]
    if constants == 0:
        tick.tau_law[:] = solve_transposed(tick.J, pull)
    else:
        c = reals_at(constants, SIZE)
        tick.tau_law[:] = inverse_dynamics_kernel(c, code, tick.p, tick.R, rest, rest, load)
    return 0


class CartesianPD(PointedLaw):
    """tau = J^-T [K_p e + K_v (twist_d - twist) + G], e = [p_d - p; e_R], G only with a model.

    K_p and K_v are diagonal in the base frame. ``shortest_turn``: e_R = log(R_d R^T), the rotation vector
    (base frame) of the shortest turn from R to R_d. This error needs no Euler angles and is singular only at
    half a turn between R and R_d. For a reference at rest, an exact G and one K_p for all three rotations, V
    = kinetic energy + e.K_p e / 2 decreases by twist.K_v twist (Bullo and Murray, 1995). With three different
    K_p this holds to first order in e.

    ``vector_difference``, for comparison: the often printed e_R = phi_d - phi, phi the rotation vector of the
    measured pose. Away from phi = 0 it is a different law. Its stiffness is K_p times the inverse of
    d omega / d phi', which is not symmetric, so no energy function exists. e_R jumps where the platform
    itself is turned by half a turn.

    tau is NaN where J is singular.
    """

    dtype = GAINS
    fill = _fill

    def __init__(self, K_p: Array, K_v: Array, model: Model | None, rotation_error: RotationError) -> None:
        """Law with diagonal gains K_p (6,) N/m, N m/rad, K_v (6,) N s/m, N m s/rad, position first."""
        super().__init__(model, K_p, K_v, rotation_error == "vector_difference")
