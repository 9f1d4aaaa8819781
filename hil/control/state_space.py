"""A linear controller around inverse dynamics (H-infinity or mu synthesis on the linearised axes).

::

    y = [e; de]                        of each axis; the file's `inputs` select the rows
    x[k+1] = A x[k] + B y[k] + L a[k]  a: change of the acceleration u by the limits
    u[k]   = C x[k] + D y[k]
    ddq*   = ddq_d + u                 then inverse dynamics

Anti-windup (K. J. Astrom and L. Rundqwist, Integrator windup and how to avoid it, ACC 1989: an observer of
the controller's own state). While a limit reduces the forces, the axes accelerate by u + a with
a = J M^-1 J^T shortfall (legs) instead of u, and the state is updated as if u + a had been requested:

    x[k+1] = A x + B y + L (sat(u) - u) = (A - L C) x + (B - L D) y + L sat(u)

The state stays bounded if A - L C is stable, for any A. The map from force to acceleration is the inverse of
the law's own linear part, by its own model at the measured pose. The map is a full matrix: limiting one leg
slows its neighbours, and their controllers must account for it. Axes of the pose have the error e = [p_d - p;
log(R_d R^T)] of `hil.control.pose_inverse_dynamics`.

No delay compensation: the controller was designed for an axis that includes the delay.
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
"""Input of a controller -> its row in y = [e; de]."""
GAINS = np.dtype(
    [
        ("pose", "<i8"),
        ("order", "<i8"),
        ("D", "<f8", 2),
        *((name, "<i8") for name in ("A", "B", "C", "L", "x")),
    ]
)
"""Layout: 1 (axes of the pose) or 0 (legs); n; D; addresses of A (n, n), B (n, 2), C, L (n,), x (n, 6)."""


class StateSpaceSettings(ModelBasedSettings):
    """A linear controller of `hil design` around inverse dynamics: ddq* = ddq_d + u, in the file's axes."""

    axes = "designed"
    uncertified = "the states of its controller are part of the error dynamics"
    law: Literal["state_space"]
    controller_file: str
    """File written by `hil design`, relative to this file's folder, or the name of a shipped controller:
    hinf."""

    @model_validator(mode="after")
    def _no_looking_ahead(self) -> Self:
        if self.delay_compensation is not None:
            raise ValueError(
                "delay_compensation is not allowed with law state_space, because its controller was designed "
                "for an axis that includes the delay; remove it"
            )
        return self

    def build(self, context: LawContext) -> StateSpace:
        """Build the control law with the controller that was read from the file.

        Raises ConfigurationError if the controller was sampled for another rate than the loop's.
        """
        controller = context.controller
        if controller is None:
            raise ConfigurationError(f"controller.controller_file: {self.controller_file} was not read")
        require_rate(controller, 1.0 / context.period_s)
        return StateSpace(context.model(self.model), controller)

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Keys that select the shipped controller; its bandwidth is that of its design."""
        del loop
        return {"controller_file": "hinf", "delay_compensation": None}


@kernel(VECTOR, INTEGER, VECTOR, MATRIX, VECTOR)
def accelerations(c: Array, code: int, p: Array, R: Array, tau: Array) -> Array:
    """Accelerations [M^-1 J^T tau; J M^-1 J^T tau] (2, 6) of platform and legs; nan where M is singular.

    M and J are those of the model variant. The force of one leg moves all legs.
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
    """Acceleration [dv; L(r)^-1 E domega] (6,) m/s^2, rad/s^2, for dtwist = [dv; domega] of the platform.

    errors (2, 6): see `pose_errors`. The rotation vector r = log(R_d R^T) then has the second derivative
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
    """Change of the last acceleration u (6,) by the force limits, m/s^2, rad/s^2, from the shortfall."""
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
    """Compute the acceleration u (6,), advance x (n, 6). y (2, 6): e, de; taken (6,): change of the last u.

    The axes are the inner loop: six independent sums, each in the order of the states.
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

    Mutable state: ``x`` (n, 6), zero after `reset`. The law then starts with D y alone; the cycle's bumpless
    entry compensates that force.
    """

    dtype = GAINS
    fill = _fill

    def __init__(self, model: Model, controller: LinearController) -> None:
        n = len(controller.A)
        self.order = n
        """Number of states of one axis' controller."""
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
        """Set the controller's state x (n, 6) to zero."""
        self.x[:] = 0.0


def require_rate(controller: LinearController, rate_Hz: float) -> None:
    """Raise ConfigurationError unless the loop runs at the sampling rate of the controller's design."""
    if abs(controller.rate_Hz - rate_Hz) > 1e-9 * rate_Hz:
        raise ConfigurationError(
            f"controller.controller_file: designed for {controller.rate_Hz:g} Hz, but the loop runs at "
            f"{rate_Hz:g} Hz; design the controller again for this rate"
        )
