"""The axes that inverse dynamics leaves: error, force for a demanded acceleration, and what a force does.

An axis obeys ddy = ddy* where the model is exact: y the leg lengths, or position and rotation of the platform
with the error of `hil.control.pose_inverse_dynamics`, e = [p_d - p; log(R_d R^T)]. A law asks for
ddy* = ddy_d + u, so that the error obeys e'' = -u.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, kernel
from drivers.tick_columns import Record
from hil.config.axis_model import AxisSpace
from hil.control.inverse_dynamics import linearising_tau
from hil.control.pose_inverse_dynamics import demanded_dtwist, pose_errors
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import rotation_motion_kernel, rotation_vector_rate
from hil.mathematics.vectors import at, rotate
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import fill_jacobian, inverse_dynamics_kernel, model_inertia


class Axes(Protocol):
    """Six axes, each a double integrator as far as the model is exact."""

    def errors(self, tick: Record) -> Array:
        """Return [e; de] (2, 6) m, rad and their rates."""

    def tau(self, tick: Record, errors: Array, u: Array) -> Array:
        """Return tau (6,) N for the reference's acceleration and u (6,) m/s^2, rad/s^2 on top."""

    def acceleration(self, tick: Record, errors: Array, tau: Array) -> Array:
        """Return the u (6,) that brings tau (6,) N about: inverse of the linear part of `tau`."""


class JointAxes:
    """The legs: ddq* = ddq_d + u, tau = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction.

    A force tau by itself accelerates the legs by J M^-1 J^T tau: one leg's force moves them all.
    """

    def __init__(self, model: Model) -> None:
        self.model = model

    def errors(self, tick: Record) -> Array:
        """Return [q_d - q; dq_d - dq] (2, 6) m, m/s."""
        return np.stack((tick["q_d"] - tick["q"], tick["dq_d"] - tick["dq"]))

    def tau(self, tick: Record, errors: Array, u: Array) -> Array:
        """Return tau (6,) N; NaN where J is singular."""
        del errors
        return linearising_tau(self.model, tick, tick["ddq_d"] + u)

    def acceleration(self, tick: Record, errors: Array, tau: Array) -> Array:
        """Return J M^-1 J^T tau (6,) m/s^2."""
        del errors
        answer: Array = _answer(self.model.constants, self.model.code, tick["p"], tick["R"], tau)[1]
        return answer


class PoseAxes:
    """Position and rotation: tau = J^-T (M dtwist* + H + G - wrench) + friction, dtwist* for e'' = -u.

    A force tau by itself accelerates the platform by dtwist = M^-1 J^T tau, [dv; domega]; of the rotation
    vector r = log(R_d R^T) the second derivative is then -L(r)^-1 E domega, E = R_d R^T.
    """

    def __init__(self, model: Model) -> None:
        self.model = model

    def errors(self, tick: Record) -> Array:
        """Return [p_d - p, r; v_d - v, dr] (2, 6) m, rad and 1/s of them."""
        return pose_errors(*(tick[name] for name in ("p", "R", "twist", "p_d", "R_d", "twist_d")))

    def tau(self, tick: Record, errors: Array, u: Array) -> Array:
        """Return tau (6,) N; NaN where J is singular."""
        model, twist = self.model, tick["twist"]
        dtwist = demanded_dtwist(errors, u, twist, tick["twist_d"], tick["dtwist_d"])
        return inverse_dynamics_kernel(
            model.constants, model.code, tick["p"], tick["R"], twist, dtwist, tick["wrench"]
        )

    def acceleration(self, tick: Record, errors: Array, tau: Array) -> Array:
        """Return [dv; L(r)^-1 E domega] (6,) m/s^2, rad/s^2."""
        dtwist = _answer(self.model.constants, self.model.code, tick["p"], tick["R"], tau)[0]
        return _pose_axes(errors, dtwist)


AXES: dict[AxisSpace, Callable[[Model], Axes]] = {"joint": JointAxes, "pose": PoseAxes}
"""`axes` of a controller's file -> what linearises them."""


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR)
def _answer(c: Array, code: int, p: Array, R: Array, tau: Array) -> Array:
    """Return [M^-1 J^T tau; J M^-1 J^T tau] (2, 6) with the M and J of the variant; nan: M is singular."""
    M = np.empty((6, 6))
    model_inertia(c, code, p, R, M)
    J = np.empty((6, 6))
    fill_jacobian(c, code, p, R, J)
    f = np.zeros(6)
    for i in range(6):
        for j in range(6):
            f[j] += J[i, j] * tau[i]
    answer = np.zeros((2, 6))
    LU = np.empty((6, 6))
    order = np.empty(6, np.int64)
    if lu_factor(M, LU, order):
        lu_solve(LU, order, f, answer[0])
        for i in range(6):
            for j in range(6):
                answer[1, i] += J[i, j] * answer[0, j]
    else:
        answer[:] = np.nan
    return answer


@kernel(MATRIX, VECTOR)
def _pose_axes(errors: Array, dtwist: Array) -> Array:
    r = errors[0, 3:].copy()
    still = np.zeros(3)
    E, _, _ = rotation_motion_kernel(r, still, still)
    acceleration = dtwist.copy()
    acceleration[3:] = rotation_vector_rate(r, np.array(rotate(E, at(dtwist, 3))))
    return acceleration
