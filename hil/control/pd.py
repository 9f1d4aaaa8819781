"""Decentralised PD on leg lengths (control notes, section 6.1.1)."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import VECTOR, kernel
from hil.config import DriveGains
from hil.control.law import LawContext, per_leg
from hil.signals import Effort, Reference, State


class JointPD:
    """tau = K_p (q_d - q) + K_v (dq_d - dq) + m ddq_d, K_p, K_v and m diagonal.

    m is what each drive has to accelerate along its own leg. Where gears make it dominate the platform,
    m ddq_d is all the feed-forward that a leg needs, and nothing couples the legs (Siciliano, Sciavicco,
    Villani and Oriolo, Robotics, 2009, 8.3). A leg of mass m alone follows m E'' + K_v E' + K_p E = 0,
    E = q_d - q. m = 0 is the notes' law.

    No mutable state.
    """

    def __init__(self, K_p: Array, K_v: Array, m: Array) -> None:
        """K_p (6,) N/m, K_v (6,) N s/m and m (6,) kg are the diagonals."""
        self.K_p = K_p
        self.K_v = K_v
        self.m = m

    @classmethod
    def build(cls, settings: DriveGains, context: LawContext) -> JointPD:
        """Make the law from its section of the configuration; it needs no model."""
        del context
        return cls(
            per_leg(settings.kp_N_m), per_leg(settings.kv_N_s_m), per_leg(settings.feedforward_mass_kg)
        )

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N."""
        del shortfall
        return Effort(
            _tau(self.K_p, self.K_v, self.m, state.q, state.dq, reference.q, reference.dq, reference.ddq)
        )


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR)
def _tau(
    K_p: Array, K_v: Array, m: Array, q: Array, dq: Array, q_d: Array, dq_d: Array, ddq_d: Array
) -> Array:
    tau = np.empty(6)
    for i in range(6):
        tau[i] = K_p[i] * (q_d[i] - q[i]) + K_v[i] * (dq_d[i] - dq[i]) + m[i] * ddq_d[i]
    return tau
