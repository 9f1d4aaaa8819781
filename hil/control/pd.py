"""Decentralised PD on leg lengths (control notes, section 6.1.1)."""

from __future__ import annotations

from hil.config import LegSpin, PDSettings
from hil.control.law import per_leg
from hil.geometry import Platform
from hil.signals import Array, Effort, Reference, State


class JointPD:
    """tau = K_p (q_d - q) + K_v (dq_d - dq), K_p and K_v diagonal.

    No mutable state.
    """

    def __init__(self, K_p: Array, K_v: Array) -> None:
        """K_p (6,) N/m and K_v (6,) N s/m are the diagonals."""
        self.K_p = K_p
        self.K_v = K_v

    @classmethod
    def build(cls, settings: PDSettings, platform: Platform, leg_spin: LegSpin) -> JointPD:
        """Make the law from its section of the configuration; it needs no model."""
        del platform, leg_spin
        return cls(per_leg(settings.kp_N_m), per_leg(settings.kv_N_s_m))

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference) -> Effort:
        """Return tau (6,) N."""
        return Effort(self.K_p * (reference.q - state.q) + self.K_v * (reference.dq - state.dq))
