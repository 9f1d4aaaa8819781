"""Inverse dynamics with a Lyapunov redesign of its outer loop, for a model with bounded error.

M. W. Spong, S. Hutchinson and M. Vidyasagar, Robot Modeling and Control, 2006, section 8.4.

::

    e = q_d - q,  x = [e; de],  A = [0 I; -K_P -K_D],  B = [0; I]
    ddq* = ddq_d + K_D de + K_P e + w
    w    = rho y / max(|y|, epsilon),  y = B^T P x,  A^T P + P A = -Q
    tau  = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction

Stability: the model error is an acceleration d (6,) of the legs, and the closed loop is
dx/dt = A x - B (w + d). With V = x^T P x

    dV/dt = -x^T Q x - 2 y^T (w + d) <= -x^T Q x - 2 |y| (rho - |d|)    outside |y| < epsilon

decreases for |d| <= rho. Inside, dV/dt <= -x^T Q x + rho epsilon / 2: x ends in a ball that shrinks with
epsilon. rho follows from `UncertaintySettings`.

Q = diag(K_D K_P, K_D) gives y = de + K_D / 2 e, in m/s. At damping ratio 1, K_D / 2 = wn and
dy/dt = -wn y - w - d. Then y never leaves |y| < epsilon again, and |e| <= epsilon / wn for each leg, as with
a sliding variable, but with one bound for all legs. Cost: docs/theory/robust.md.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any, Literal

import numpy as np

from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed
from hil.config.values import NonNegative
from hil.control.inverse_dynamics import linearise
from hil.control.law import DesiredLoop, ErrorDynamics, ErrorGains, LawContext, ModelBasedSettings
from hil.control.pointed_law import SEEN, PointedLaw
from hil.control.uncertainty import ASSUMED_m_s2, UncertaintySettings

GAINS = np.dtype([("K_P", "<f8", 6), ("K_D", "<f8", 6), ("rho", "<f8"), ("epsilon", "<f8")])


class RobustInverseDynamicsSettings(ErrorGains, ModelBasedSettings):
    """Inverse dynamics with an outer loop that is robust to bounded uncertainty (Lyapunov redesign)."""

    tuning = ("wn_rad_s and boundary_layer_m_s", "reduce wn, increase the layer,")
    knob = {"wn_rad_s": 1, "boundary_layer_m_s": -1}
    law: Literal["robust_inverse_dynamics"]
    uncertainty: UncertaintySettings
    boundary_layer_m_s: NonNegative
    """epsilon: the law is linear while |de + zeta wn e| over all legs is below it; |e| <= epsilon / wn at
    damping ratio 1. 0: the law switches and chatters.
    """

    @property
    def bound(self) -> float:
        """Bound rho, m/s^2, on the norm of the model error over all six legs: sqrt(6) times that of a leg."""
        return sqrt(6.0) * self.uncertainty.bound()

    def build(self, context: LawContext) -> RobustInverseDynamics:
        """Build the control law from these settings."""
        model = context.model(self.model)
        return RobustInverseDynamics(model, *self.gains(), self.bound, self.boundary_layer_m_s)

    def error_dynamics(self) -> ErrorDynamics:
        """Linear error dynamics inside the boundary layer, and how the law saturates outside."""
        K_P, K_D = self.gains()
        slope, layer = K_D / 2.0, self.boundary_layer_m_s
        steepness = self.bound / layer if layer > 0.0 else inf
        gains = K_P + steepness * slope, K_D + steepness
        return ErrorDynamics(*gains, slope=slope, steepness=steepness, layer=layer, shared=True)

    def described(self) -> list[str]:
        """Line that `hil check` prints: the uncertainty bound rho and the boundary layer."""
        return [f"bound rho {self.bound:.3g} m/s^2, boundary layer {self.boundary_layer_m_s:.3g} m/s"]

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Keys for the desired loop: default disturbance, a boundary layer that keeps the loop's speed."""
        return {
            **super().derived(loop),
            "uncertainty": {"disturbance_m_s2": ASSUMED_m_s2},
            "boundary_layer_m_s": sqrt(6.0) * ASSUMED_m_s2 / loop.wn,
        }


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(g: Any, constants: int, code: int, tick: Any) -> int:
    ddq_star, y = np.empty(6), np.empty(6)
    square = 0.0
    for i in range(6):
        e, de = tick.q_d[i] - tick.q[i], tick.dq_d[i] - tick.dq[i]
        ddq_star[i] = tick.ddq_d[i] + g.K_D[i] * de + g.K_P[i] * e
        y[i] = de + 0.5 * g.K_D[i] * e
        square += y[i] * y[i]
    size = max(np.sqrt(square), g.epsilon)
    if size > 0.0:
        for i in range(6):
            ddq_star[i] += g.rho * (y[i] / size)
    linearise(constants, code, tick, ddq_star, tick.wrench)
    return 0


class RobustInverseDynamics(PointedLaw):
    """ddq* = ddq_d + K_D de + K_P e + rho y / max(|y|, epsilon), y = de + K_D e / 2, by inverse dynamics.

    e = q_d - q (6,) m, |y| over all legs. K_P (6,) 1/s^2 and K_D (6,) 1/s are the diagonals; rho in m/s^2,
    epsilon in m/s.
    """

    dtype = GAINS
    fill = _fill
