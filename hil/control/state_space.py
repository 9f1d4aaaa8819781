"""A designed linear controller around inverse dynamics (H-infinity or mu synthesis on the linearised axes).

::

    y = [e; de]                                        of each axis, as the file's `inputs` say
    x[k+1] = A x[k] + B y[k] + L (what the limits took from u[k])
    u[k]   = C x[k] + D y[k]
    ddq*   = ddq_d + u                                 then inverse dynamics: `hil.control.linearised_axes`

Anti-windup (K. J. Astrom and L. Rundqwist, Integrator windup and how to avoid it, ACC 1989: an observer of
the controller's own state). Where a limit holds back forces, the axes accelerate by u + a with
a = J M^-1 J^T shortfall (legs) instead of u, and the state moves as if u + a had been asked for:

    x[k+1] = A x + B y + L (sat(u) - u) = (A - L C) x + (B - L D) y + L sat(u)

which stays bounded wherever A - L C is stable, whatever A is. The map from force to acceleration is the
inverse of the law's own linear part, by its own model at the present pose, and it is full: a leg that is held
back slows its neighbours, and their controllers have to know.

No delay compensation: the delay is in the axis that the controller was designed for.
"""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from pydantic import model_validator

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import MATRIX, OUT_MATRIX, VECTOR, kernel
from drivers.errors import ConfigurationError
from drivers.tick_columns import Record
from hil.config.linear_controller import LinearController
from hil.control.law import DesiredLoop, LawContext, ModelBasedSettings
from hil.control.linearised_axes import AXES, Axes

_INPUTS = {"error": 0, "rate_error": 1}
"""Row of the axes' errors."""


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
        return StateSpace(AXES[controller.axes](context.model(self.model)), controller)

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Return the shipped controller, at the rate and for the delay that it was made for."""
        del loop
        return {"controller_file": "hinf", "delay_compensation": None}


class StateSpace:
    """ddq* = ddq_d + C x + D y, x[k+1] = A x + B y + L a, for six axes with one controller.

    Mutable state: ``x`` (n, 6), zero after `reset`. With it the law begins as its D alone, and the cycle's
    entry takes off what that asks for.
    """

    def __init__(self, axes: Axes, controller: LinearController) -> None:
        n = len(controller.A)
        self.axes = axes
        self.order = n
        """States of the controller of one axis."""
        self.A = np.array(controller.A, float).reshape(n, n)
        self.B, self.D = np.zeros((n, 2)), np.zeros(2)
        for column, name in enumerate(controller.inputs):
            self.B[:, _INPUTS[name]] += [row[column] for row in controller.B]
            self.D[_INPUTS[name]] += controller.D[0][column]
        self.C = np.array(controller.C[0], float)
        self.L = np.array(controller.anti_windup, float)
        self.reset()

    def reset(self) -> None:
        """Back to x = 0."""
        self.x = np.zeros((self.order, 6))

    def effort(self, tick: Record) -> None:
        """Fill tau_law; NaN where J is singular. Takes the controller one step on."""
        errors, shortfall = self.axes.errors(tick), tick["shortfall"]
        taken = self.axes.acceleration(tick, errors, shortfall) if shortfall.any() else ZERO6
        u = _step(self.A, self.B, self.C, self.D, self.L, self.x, errors, taken)
        tick["tau_law"] = self.axes.tau(tick, errors, u)


def require_rate(controller: LinearController, rate_Hz: float) -> None:
    """Refuse to run a controller at another rate than that it was sampled for. Raises ConfigurationError."""
    if abs(controller.rate_Hz - rate_Hz) > 1e-9 * rate_Hz:
        raise ConfigurationError(
            f"controller.controller_file: made for {controller.rate_Hz:g} Hz, and the loop runs at "
            f"{rate_Hz:g} Hz, where it is another controller; design again for that rate"
        )


@kernel(MATRIX, MATRIX, VECTOR, VECTOR, VECTOR, OUT_MATRIX, MATRIX, VECTOR)
def _step(
    A: Array, B: Array, C: Array, D: Array, L: Array, x: Array, y: Array, taken: Array
) -> Array:  # fmt: skip
    """Return u (6,) and take x (n, 6) one step on. y (2, 6): e and de; taken (6,): of the last u.

    The axes are the inner loop: six sums side by side, each in the order of the states.
    """
    n = len(C)
    u = np.empty(6)
    for k in range(6):
        u[k] = D[0] * y[0, k] + D[1] * y[1, k]
    for i in range(n):
        for k in range(6):
            x[i, k] += L[i] * taken[k]
            u[k] += C[i] * x[i, k]
    after = np.empty((n, 6))
    for i in range(n):
        for k in range(6):
            after[i, k] = B[i, 0] * y[0, k] + B[i, 1] * y[1, k]
        for j in range(n):
            for k in range(6):
                after[i, k] += A[i, j] * x[j, k]
    for i in range(n):
        for k in range(6):
            x[i, k] = after[i, k]
    return u
