"""Inverse dynamics control in pose space (control notes, section 6.1.3 A: the pose is measured)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, kernel, record
from drivers.compiled.pointed import pointed, reals_at
from hil.control.law import ErrorGains, LawContext, ModelBasedSettings
from hil.control.pointed_law import SEEN, PointedLaw
from hil.mathematics.rotations import relative_rotation, rotation_motion_kernel, rotation_vector_rate
from hil.mathematics.vectors import add, at, cross, rotate, rotate_back, sub
from hil.robot.dynamics_kernels import SIZE, inverse_dynamics_kernel

GAINS = np.dtype([("K_P", "<f8", 6), ("K_D", "<f8", 6)])


class PoseInverseDynamicsSettings(ErrorGains, ModelBasedSettings):
    """Inverse dynamics control in pose space; exact with model variant `full`."""

    axes = "pose"
    law: Literal["pose_inverse_dynamics"]

    def build(self, context: LawContext) -> PoseInverseDynamics:
        """Build the control law from these settings."""
        return PoseInverseDynamics(context.model(self.model), *self.gains())


@kernel(VECTOR, MATRIX, VECTOR, VECTOR, MATRIX, VECTOR)
def pose_errors(p: Array, R: Array, twist: Array, p_d: Array, R_d: Array, twist_d: Array) -> Array:
    """Pose errors [e; de] (2, 6): e = [p_d - p; r] m, rad, r = log(R_d R^T); de = de/dt m/s, rad/s."""
    r = relative_rotation(R, R_d)
    still = np.zeros(3)
    E, _, _ = rotation_motion_kernel(r, still, still)
    dr = rotation_vector_rate(r, np.array(sub(at(twist_d, 3), rotate(E, at(twist, 3)))))
    errors = np.empty((2, 6))
    for i in range(3):
        errors[0, i] = p_d[i] - p[i]
        errors[1, i] = twist_d[i] - twist[i]
        errors[0, 3 + i] = r[i]
        errors[1, 3 + i] = dr[i]
    return errors


@kernel(MATRIX, VECTOR, VECTOR, VECTOR, VECTOR)
def demanded_dtwist(errors: Array, u: Array, twist: Array, twist_d: Array, dtwist_d: Array) -> Array:
    """Acceleration dtwist* (6,) m/s^2, rad/s^2 with which the pose errors [e; de] (2, 6) obey e'' = -u."""
    r, dr = errors[0, 3:].copy(), errors[1, 3:].copy()
    E, _, dOmega = rotation_motion_kernel(r, dr, -u[3:])
    E_omega = rotate(E, at(twist, 3))
    turning = sub(at(twist_d, 3), E_omega)
    domega = rotate_back(E, sub(at(dtwist_d, 3), add(cross(turning, E_omega), at(dOmega, 0))))
    dtwist = np.empty(6)
    for i in range(3):
        dtwist[i] = dtwist_d[i] + u[i]
        dtwist[3 + i] = domega[i]
    return dtwist


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    c, p, R, twist = reals_at(constants, SIZE), tick.p, tick.R, tick.twist
    errors = pose_errors(p, R, twist, tick.p_d, tick.R_d, tick.twist_d)
    u = np.empty(6)
    for i in range(6):
        u[i] = k.K_D[i] * errors[1, i] + k.K_P[i] * errors[0, i]
    dtwist = demanded_dtwist(errors, u, twist, tick.twist_d, tick.dtwist_d)
    tick.tau_law[:] = inverse_dynamics_kernel(c, code, p, R, twist, dtwist, tick.wrench)
    return 0


class PoseInverseDynamics(PointedLaw):
    """tau = J^-T (M dtwist* + H + G - wrench) + friction, all at the measured pose.

    With an exact model dtwist = dtwist*. dtwist* is chosen so that e = [p_d - p; r], r = log(R_d R^T) the
    rotation vector of the shortest turn from R to R_d (base frame), obeys e'' + K_D e' + K_P e = 0 in
    all six components, exactly and for all turns below half a turn:

    - position: dv* = dv_d + K_D (v_d - v) + K_P (p_d - p);
    - rotation: E = R_d R^T = exp([r]x) turns with Omega = omega_d - E omega, hence r' = L(r)^-1 Omega with
      L = d Omega / d r' (``hil.mathematics.rotations.rotation_vector_rate``), and
      domega* = E^T (domega_d - Omega x E omega - Omega'*), Omega'* the Omega' of r'' = -K_D r' - K_P r.

    Often r' is replaced by omega_d - omega. The difference is not the derivative of r, not even to first
    order, where r' = omega_d - omega - r x omega. The error dynamics of that law change with the speed.

    K_P (6,) 1/s^2 and K_D (6,) 1/s are the diagonals, position first, axes of the base frame.
    """

    dtype = GAINS
    fill = _fill
