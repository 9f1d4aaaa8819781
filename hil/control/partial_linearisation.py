"""Inverse dynamics control with H and the external load left out (control notes, section 6.1.3 B)."""

from __future__ import annotations

from typing import Literal

from hil.config.model import MechanicsSettings, ModelSettings
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.control.law import ErrorGains, LawContext


class PartialLinearisationSettings(ErrorGains):
    """Inverse dynamics in joint space without H and external load."""

    compensates_wrench = False
    law: Literal["partial_linearisation"]
    model: MechanicsSettings = MechanicsSettings()

    @property
    def believed(self) -> ModelSettings:
        """The law's model of the robot: always without H."""
        return ModelSettings(variant="no_H", **dict(self.model))

    def build(self, context: LawContext) -> PartialLinearisation:
        """Return the law."""
        return PartialLinearisation(context.model(self.believed), *self.gains())


class PartialLinearisation(JointInverseDynamics):
    """tau = J^-T [M J^-1 (ddq* - J_dot twist) + G] + friction, ddq* = ddq_d + K_D dE + K_P E, E = q_d - q.

    The exact law less H and wrench, which stay as a disturbance: with exact M, G, J it leaves
    E'' + K_D E' + K_P E = J M^-1 (H - wrench). Without G there would be a constant error, without J_dot twist
    a far larger one than H's: on the book's path (wn 20 rad/s) H costs 0.23 mm of leg error, J_dot twist 2.6.
    """

    compensates_wrench = False
