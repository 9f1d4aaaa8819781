"""Inverse dynamics without centripetal forces H and external load (control notes, section 6.1.3 B)."""

from __future__ import annotations

from typing import Literal

from hil.config.model import MechanicsSettings, ModelSettings
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.control.law import ErrorGains, LawContext


class PartialLinearisationSettings(ErrorGains):
    """Inverse dynamics in joint space, without centripetal and gyroscopic forces H and external load."""

    compensates_wrench = False
    law: Literal["partial_linearisation"]
    model: MechanicsSettings = MechanicsSettings()

    @property
    def believed(self) -> ModelSettings:
        """Settings of the law's robot model, always without centripetal and gyroscopic forces H."""
        return ModelSettings(variant="no_H", **dict(self.model))

    def build(self, context: LawContext) -> PartialLinearisation:
        """Build the control law from these settings."""
        return PartialLinearisation(context.model(self.believed), *self.gains())


class PartialLinearisation(JointInverseDynamics):
    """tau = J^-T [M J^-1 (ddq* - J_dot twist) + G] + friction, ddq* = ddq_d + K_D dE + K_P E, E = q_d - q.

    H and wrench remain as a disturbance: with exact M, G, J the error obeys
    E'' + K_D E' + K_P E = J M^-1 (H - wrench). Omitting G would leave a constant error. Omitting J_dot twist
    costs more than omitting H: on the book's path (wn 20 rad/s) 2.6 mm of leg error instead of 0.23 mm.
    """

    compensates_wrench = False
