"""A designed linear controller around inverse dynamics (H-infinity or mu synthesis on the linearised axes).

::

    y = [e; de]                                        of each axis, as the file's `inputs` say
    x[k+1] = A x[k] + B y[k] + L (what the limits took from u[k])
    u[k]   = C x[k] + D y[k]
    ddq*   = ddq_d + u                                 then inverse dynamics

Anti-windup (K. J. Astrom and L. Rundqwist, Integrator windup and how to avoid it, ACC 1989: an observer of
the controller's own state). Where a limit holds back forces, the axes accelerate by u + a with
a = J M^-1 J^T shortfall (legs) instead of u, and the state moves as if u + a had been asked for:

    x[k+1] = A x + B y + L (sat(u) - u) = (A - L C) x + (B - L D) y + L sat(u)

which stays bounded wherever A - L C is stable, whatever A is. The map from force to acceleration is the
inverse of the law's own linear part, by its own model at the present pose, and it is full: a leg that is held
back slows its neighbours, and their controllers have to know. Axes of the pose have the error
e = [p_d - p; log(R_d R^T)] of `hil.control.pose_inverse_dynamics`.

No delay compensation: the delay is in the axis that the controller was designed for.
"""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from pydantic import model_validator

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, VECTOR, helper, kernel, record
from drivers.compiled.pointed import data_at, pointed, reals_at
from drivers.errors import ConfigurationError
from hil.config.linear_controller import LinearController
from hil.control.inverse_dynamics import linearise
from hil.control.law import DesiredLoop, LawContext, ModelBasedSettings
from hil.control.pointed_law import SEEN, PointedLaw
from hil.control.pose_inverse_dynamics import demanded_dtwist, pose_errors
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import rotation_motion_kernel, rotation_vector_rate
from hil.mathematics.vectors import at, rotate
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, fill_jacobian, inverse_dynamics_kernel, model_inertia

_INPUTS = {"error": 0, "rate_error": 1}
"""Row of the axes' errors."""
GAINS = np.dtype(
    [
        ("pose", "<i8"),
        ("order", "<i8"),
        ("D", "<f8", 2),
        *((name, "<i8") for name in ("A", "B", "C", "L", "x")),
    ]
)
"""Whether the axes are the pose's; n; D; where A (n, n), B (n, 2), C, L (n,) and the state x (n, 6) are.
"""


class StateSpaceSettings(ModelBasedSettings):
    """A controller of `hil design` around inverse dynamics: ddq* = ddq_d + u, in the file's axes."""

    axes = "designed"
    uncertified = "its own states are part of the error dynamics"
    law: Literal["state_space"]
    controller_file: str
    """What `hil design` wrote, relative to this file's folder, or the name of a shipped one: hinf."""

    @model_validator(mode="after")
    def _no_looking_ahead(self) -> Self:
        if self.delay_compensation is not None:
            raise ValueError(
                "delay_compensation has no meaning for law state_space: its controller was designed for an "
                "axis with the delay in it, and one that looks ahead is another axis; leave it out"
            )
        return self

    def build(self, context: LawContext) -> StateSpace:
        """Return the law, which runs the controller of the context.

        Raises ConfigurationError where the controller was sampled for another rate than the loop's.
        """
        controller = context.controller
        if controller is None:
            raise ConfigurationError(f"controller.controller_file: {self.controller_file} was not read")
        require_rate(controller, 1.0 / context.period_s)
        return StateSpace(context.model(self.model), controller)

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Return the shipped controller, at the rate and for the delay that it was made for."""
        del loop
        return {"controller_file": "hinf", "delay_compensation": None}


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR)
def accelerations(c: Array, code: int, p: Array, R: Array, tau: Array) -> Array:
    """Return [M^-1 J^T tau; J M^-1 J^T tau] (2, 6), of platform and legs; nan: M is singular.

    With the M and J of the variant. One leg's force moves all legs.
    """
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
def pose_acceleration(errors: Array, dtwist: Array) -> Array:
    """Return [dv; L(r)^-1 E domega] (6,) m/s^2, rad/s^2, for dtwist = [dv; domega] of the platform.

    errors (2, 6): of `pose_errors`. Of the rotation vector r = log(R_d R^T) the second derivative is then
    -L(r)^-1 E domega, E = R_d R^T.
    """
    r = errors[0, 3:].copy()
    still = np.zeros(3)
    E, _, _ = rotation_motion_kernel(r, still, still)
    acceleration = dtwist.copy()
    acceleration[3:] = rotation_vector_rate(r, np.array(rotate(E, at(dtwist, 3))))
    return acceleration


@helper
def _taken(k: Any, constants: int, code: int, tick: Any, errors: Array) -> Array:
    """Return what the limits took from the last u, (6,) m/s^2, rad/s^2: of the axes, for the shortfall."""
    taken, limited = np.zeros(6), False
    for i in range(6):
        limited = limited or tick.shortfall[i] != 0.0
    if limited:
        c = reals_at(constants, SIZE)
        found = accelerations(c, code, tick.p, tick.R, tick.shortfall)
        for i in range(6):
            taken[i] = found[1, i]
        if k.pose:
            taken = pose_acceleration(errors, found[0])
    return taken


@helper
def _step(k: Any, y: Array, taken: Array) -> Array:
    """Return u (6,) and take x (n, 6) one step on. y (2, 6): e and de; taken (6,): of the last u.

    The axes are the inner loop: six sums side by side, each in the order of the states.
    """
    n = k.order
    A, B, C, L = reals_at(k.A, n * n), reals_at(k.B, 2 * n), reals_at(k.C, n), reals_at(k.L, n)
    x, after, u = reals_at(k.x, 6 * n), np.empty(6 * n), np.empty(6)
    for axis in range(6):
        u[axis] = k.D[0] * y[0, axis] + k.D[1] * y[1, axis]
    for i in range(n):
        for axis in range(6):
            x[6 * i + axis] += L[i] * taken[axis]
            u[axis] += C[i] * x[6 * i + axis]
    for i in range(n):
        for axis in range(6):
            after[6 * i + axis] = B[2 * i] * y[0, axis] + B[2 * i + 1] * y[1, axis]
        for j in range(n):
            for axis in range(6):
                after[6 * i + axis] += A[n * i + j] * x[6 * j + axis]
    for i in range(n):
        for axis in range(6):
            x[6 * i + axis] = after[6 * i + axis]
    return u


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    """Fill tau_law and take the controller one step on."""
    twist = tick.twist
    if k.pose:
        errors = pose_errors(tick.p, tick.R, twist, tick.p_d, tick.R_d, tick.twist_d)
    else:
        errors = np.empty((2, 6))
        for i in range(6):
            errors[0, i] = tick.q_d[i] - tick.q[i]
            errors[1, i] = tick.dq_d[i] - tick.dq[i]
    u = _step(k, errors, _taken(k, constants, code, tick, errors))
    if k.pose:
        dtwist = demanded_dtwist(errors, u, twist, tick.twist_d, tick.dtwist_d)
        c = reals_at(constants, SIZE)
        tick.tau_law[:] = inverse_dynamics_kernel(c, code, tick.p, tick.R, twist, dtwist, tick.wrench)
    else:
        for i in range(6):
            u[i] = tick.ddq_d[i] + u[i]
        linearise(constants, code, tick, u, tick.wrench)
    return 0


class StateSpace(PointedLaw):
    """ddq* = ddq_d + C x + D y, x[k+1] = A x + B y + L a, for six axes with one controller.

    tau is NaN where J is singular.

    Mutable state: ``x`` (n, 6), zero after `reset`. With it the law begins as its D alone, and the cycle's
    entry takes off what that asks for.
    """

    dtype = GAINS
    fill = _fill

    def __init__(self, model: Model, controller: LinearController) -> None:
        n = len(controller.A)
        self.order = n
        """States of the controller of one axis."""
        A = np.array(controller.A, float).reshape(n, n)
        B, D = np.zeros((n, 2)), np.zeros(2)
        for column, name in enumerate(controller.inputs):
            B[:, _INPUTS[name]] += [row[column] for row in controller.B]
            D[_INPUTS[name]] += controller.D[0][column]
        C, L = np.array(controller.C[0], float), np.array(controller.anti_windup, float)
        self.x = np.zeros((n, 6))
        self._matrices = A, B, C, L
        super().__init__(model, controller.axes == "pose", n, D, *map(data_at, (*self._matrices, self.x)))

    def reset(self) -> None:
        """Back to x = 0."""
        self.x[:] = 0.0


def require_rate(controller: LinearController, rate_Hz: float) -> None:
    """Refuse to run a controller at another rate than that it was sampled for. Raises ConfigurationError."""
    if abs(controller.rate_Hz - rate_Hz) > 1e-9 * rate_Hz:
        raise ConfigurationError(
            f"controller.controller_file: made for {controller.rate_Hz:g} Hz, and the loop runs at "
            f"{rate_Hz:g} Hz, where it is another controller; design again for that rate"
        )
