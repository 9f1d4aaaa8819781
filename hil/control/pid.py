"""Decentralised PID on leg lengths (control notes, section 6.1.1, with an integral)."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import VECTOR, kernel
from hil.config import PIDSettings
from hil.control.law import LawContext, per_leg
from hil.control.pd import JointPD
from hil.signals import Effort, Reference, State


class JointPID:
    """tau = K_p e + K_v de + m ddq_d + xi, dxi/dt = K_i e + shortfall / T_t, |xi| <= xi_max; e = q_d - q.

    The integral takes away the error that a constant load leaves to a PD. While a limit holds the force back,
    ``shortfall``, what was told less what was asked, leads xi to where the law asks for no more than the
    limit gives (back-calculation: Astrom and Hagglund, PID Controllers, 1995, 3.5; by default with their
    T_t = sqrt(T_i T_d) = sqrt(K_v / K_i)). Euler's rule with the period of the loop; a T_t below one period
    counts as one period.

    Mutable state: ``xi``; `reset` makes it zero. The entry of the cycle is bumpless with that: its offset
    carries the load while it fades, and the integral takes over.
    """

    def __init__(
        self, pd: JointPD, K_i: Array, xi_max: Array, period_s: float, T_t: float | None = None
    ) -> None:
        """K_i (6,) N/(m s) and xi_max (6,) N; T_t in s."""
        self.pd = pd
        self.xi_max = xi_max
        self.K_i_T = period_s * K_i
        tracking = np.sqrt(pd.K_v / K_i) if T_t is None else np.full(6, T_t)
        self.share = np.minimum(period_s / tracking, 1.0)
        """(6,) of the shortfall that one call takes out of xi."""
        self.reset()

    @classmethod
    def build(cls, settings: PIDSettings, context: LawContext) -> JointPID:
        """Make the law from its section of the configuration; it needs no model."""
        return cls(
            JointPD.build(settings, context),
            per_leg(settings.ki_N_m_s),
            per_leg(settings.integral_limit_N),
            context.period_s,
            settings.tracking_time_s,
        )

    def reset(self) -> None:
        """Forget the integral."""
        self.xi = np.zeros(6)

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; adds one period to the integral."""
        tau = self.pd.effort(state, reference, shortfall).tau
        self.xi = _integral(self.xi, self.K_i_T, self.share, self.xi_max, state.q, reference.q, shortfall)
        return Effort(tau + self.xi)


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def _integral(
    xi: Array, K: Array, share: Array, xi_max: Array, q: Array, q_d: Array, shortfall: Array
) -> Array:
    """Return xi a period later; K is the integral gain times the period."""
    after = np.empty(6)
    for i in range(6):
        value = xi[i] + K[i] * (q_d[i] - q[i]) + share[i] * shortfall[i]
        after[i] = min(max(value, -xi_max[i]), xi_max[i])
    return after
