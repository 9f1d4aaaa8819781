"""Sliding mode control on the leg lengths (Slotine and Li, Applied Nonlinear Control, 1991, chapter 7).

::

    e = q_d - q,  s = de + lambda e
    ddq* = ddq_d + lambda de + k sat(s / phi)
    tau  = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction

Why it works: what the model does not know is an acceleration d of a leg, and the law leaves
ds/dt = d - k sat(s / phi). For |d| <= D, k = D + eta, outside the boundary layer |s| <= phi

    d/dt s^2 / 2 = s d - k |s| <= -eta |s|

so that s is inside within |s(0)| / eta and stays there. Inside, e follows from de + lambda e = s, a lag of
first order: |e| <= phi / lambda, whatever d is. Where D comes from: `hil.config.UncertaintySettings`.

What it costs: inside the layer the law is linear, e'' + (lambda + k / phi) e' + lambda k / phi e = d, no
better and no worse than exact inverse dynamics with these gains. Its poles are -lambda and -k / phi, and
the layer can be no thinner than the loop's delay T allows. With phi = k / lambda (the balance condition of
7.2) both poles are -lambda, the bound is |e| <= k / lambda^2, and the loop crosses over at 2.06 lambda with
a phase margin of 76 deg less 118 deg lambda T: 30 deg are left at lambda = 0.39 / T; 7.3 recommends
1 / (3 T), 37 deg (`hil.control.margin`). Where phi = 0 the law switches: s runs on by up to (k + D) T before
a changed sign acts, and the force chatters between its extremes.
"""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import REAL, VECTOR, kernel
from hil.config import SlidingModeSettings
from hil.control.inverse_dynamics import linearising_tau
from hil.control.law import LawContext
from hil.control.model import build_model
from hil.robot.dynamics import Model
from hil.signals import Effort, Reference, State


class SlidingMode:
    """ddq* = ddq_d + lambda de + k sat(s / phi), s = de + lambda e, by exact inverse dynamics.

    e = q_d - q (6,) m; sat(x) is x between -1 and 1, and sgn(s) stands for it where phi = 0, sgn(0) = 0.
    No mutable state.
    """

    def __init__(self, model: Model, slope: float, k: float, phi: float) -> None:
        """Take lambda in 1/s (``slope``), k in m/s^2 and phi in m/s, the same for all legs."""
        self.model = model
        self.slope = slope
        self.k = k
        self.phi = phi

    @classmethod
    def build(cls, settings: SlidingModeSettings, context: LawContext) -> SlidingMode:
        """Make the law and its model from their section of the configuration."""
        model = build_model(settings.model, context.platform, context.leg_spin)
        return cls(model, settings.lambda_rad_s, settings.switching_gain, settings.boundary_layer)

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        del shortfall
        ddq_star = _ddq_star(
            self.slope, self.k, self.phi, state.q, state.dq, reference.q, reference.dq, reference.ddq
        )
        return Effort(linearising_tau(self.model, state, ddq_star, state.wrench))


@kernel(REAL, REAL, REAL, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def _ddq_star(
    slope: float, k: float, phi: float, q: Array, dq: Array, q_d: Array, dq_d: Array, ddq_d: Array
) -> Array:
    ddq_star = np.empty(6)
    for i in range(6):
        de = dq_d[i] - dq[i]
        s = de + slope * (q_d[i] - q[i])
        switched = s / phi if abs(s) < phi else np.sign(s)
        ddq_star[i] = ddq_d[i] + slope * de + k * switched
    return ddq_star
