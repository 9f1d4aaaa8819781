"""Inverse dynamics with a Lyapunov redesign of its outer loop, for a model with bounded error.

M. W. Spong, S. Hutchinson and M. Vidyasagar, Robot Modeling and Control, 2006, section 8.4.

::

    e = q_d - q,  x = [e; de],  A = [0 I; -K_P -K_D],  B = [0; I]
    ddq* = ddq_d + K_D de + K_P e + w
    w    = rho y / max(|y|, epsilon),  y = B^T P x,  A^T P + P A = -Q
    tau  = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction

Why it works: what the model does not know is an acceleration d (6,) of the legs, and the law leaves
dx/dt = A x - B (w + d). With V = x^T P x

    dV/dt = -x^T Q x - 2 y^T (w + d) <= -x^T Q x - 2 |y| (rho - |d|)    outside |y| < epsilon

falls for |d| <= rho; inside, dV/dt <= -x^T Q x + rho epsilon / 2: x ends in a ball that shrinks with epsilon.
Where rho comes from: `hil.config.UncertaintySettings`.

Q = diag(K_D K_P, K_D) weighs a length against a rate as the error dynamics does, and gives
y = de + K_D / 2 e, in m/s. At damping ratio 1, K_D / 2 = wn, that is dy/dt = -wn y - w - d: |y| < epsilon is
never left again and |e| <= epsilon / wn of each leg, as of a sliding variable, but all legs share one
bound and wn y goes on growing where w no longer does.

What it costs: inside, the law is linear with the gains K_P + rho / epsilon K_D / 2 and K_D + rho / epsilon
(at damping ratio 1 poles at -wn and -(wn + rho / epsilon)), no better and no worse than exact inverse
dynamics with these. A delay of T s bounds them: the loop crosses over at about w_c = 2 wn + rho / epsilon,
and T takes 57 deg w_c T of its 76 to 90 deg of phase margin; see `hil.control.margin`.
"""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import REAL, VECTOR, kernel
from hil.config import RobustInverseDynamicsSettings
from hil.control.inverse_dynamics import linearising_tau
from hil.control.law import LawContext, error_gains
from hil.control.model import build_model
from hil.robot.dynamics import Model
from hil.signals import Effort, Reference, State


class RobustInverseDynamics:
    """ddq* = ddq_d + K_D de + K_P e + rho y / max(|y|, epsilon), y = de + K_D e / 2, by inverse dynamics.

    e = q_d - q (6,) m, |y| over all legs. No mutable state.
    """

    def __init__(self, model: Model, K_P: Array, K_D: Array, rho: float, epsilon: float) -> None:
        """K_P (6,) 1/s^2 and K_D (6,) 1/s are the diagonals; rho in m/s^2, epsilon in m/s."""
        self.model = model
        self.K_P = K_P
        self.K_D = K_D
        self.rho = rho
        self.epsilon = epsilon

    @classmethod
    def build(cls, settings: RobustInverseDynamicsSettings, context: LawContext) -> RobustInverseDynamics:
        """Make the law and its model from their section of the configuration."""
        gains = error_gains(settings.wn_rad_s, settings.damping_ratio)
        model = build_model(settings.model, context.platform, context.leg_spin)
        return cls(model, *gains, settings.bound, settings.boundary_layer_m_s)

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        del shortfall
        ddq_star = _ddq_star(
            self.K_P, self.K_D, self.rho, self.epsilon,
            state.q, state.dq, reference.q, reference.dq, reference.ddq,
        )  # fmt: skip
        return Effort(linearising_tau(self.model, state, ddq_star, state.wrench))


@kernel(VECTOR, VECTOR, REAL, REAL, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def _ddq_star(
    K_P: Array, K_D: Array, rho: float, epsilon: float,
    q: Array, dq: Array, q_d: Array, dq_d: Array, ddq_d: Array,
) -> Array:  # fmt: skip
    ddq_star = np.empty(6)
    y = np.empty(6)
    square = 0.0
    for i in range(6):
        e = q_d[i] - q[i]
        de = dq_d[i] - dq[i]
        ddq_star[i] = ddq_d[i] + K_D[i] * de + K_P[i] * e
        y[i] = de + 0.5 * K_D[i] * e
        square += y[i] * y[i]
    size = max(np.sqrt(square), epsilon)
    if size > 0.0:
        for i in range(6):
            ddq_star[i] += rho * (y[i] / size)
    return ddq_star
