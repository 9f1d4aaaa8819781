"""Inverse dynamics control with H and the external load left out (control notes, section 6.1.3 B)."""

from __future__ import annotations

from drivers.arrays import Array
from hil.config import ModelSettings, PartialLinearisationSettings
from hil.control.inverse_dynamics import linearised_pd
from hil.control.law import LawContext, error_gains
from hil.control.model import build_model
from hil.robot.dynamics import Model
from hil.signals import NO_WRENCH, Effort, Reference, State


class PartialLinearisation:
    """tau = J^-T [M J^-1 (ddq* - J_dot twist) + G] + friction, ddq* = ddq_d + K_D dE + K_P E, E = q_d - q.

    The exact law less H and wrench, which stay as a disturbance: with exact M, G, J it leaves
    E'' + K_D E' + K_P E = J M^-1 (H - wrench). Without G there would be a constant error, without J_dot twist
    a far larger one than H's: on the book's path (wn 20 rad/s) H costs 0.23 mm of leg error, J_dot twist 2.6.

    No mutable state.
    """

    def __init__(self, model: Model, K_P: Array, K_D: Array) -> None:
        """Take a model of variant no_H; K_P (6,) 1/s^2 and K_D (6,) 1/s are the diagonals."""
        self.model = model
        self.K_P = K_P
        self.K_D = K_D

    @classmethod
    def build(cls, settings: PartialLinearisationSettings, context: LawContext) -> PartialLinearisation:
        """Make the law and its model from their section of the configuration."""
        believed = ModelSettings(variant="no_H", **dict(settings.model))
        model = build_model(believed, context.platform, context.leg_spin)
        return cls(model, *error_gains(settings.wn_rad_s, settings.damping_ratio))

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        del shortfall
        unloaded = state._replace(wrench=NO_WRENCH)
        return Effort(linearised_pd(self.model, self.K_P, self.K_D, unloaded, reference))
