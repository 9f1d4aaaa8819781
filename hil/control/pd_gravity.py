"""PD on leg lengths with gravity compensation (control notes, sections 6.1.1 and 6.1.3 B: G in the loop)."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Array
from hil.config import PDGravitySettings
from hil.control.law import LawContext
from hil.control.model import build_model
from hil.control.pd import JointPD
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.signals import NO_WRENCH, Effort, Reference, State

_REST = np.zeros(6)
_REST.flags.writeable = False


class JointPDGravity:
    """tau = K_p (q_d - q) + K_v (dq_d - dq) + m ddq_d + J^-T G, J and G at the measured pose.

    With an exact G a reference at rest is reached without error: V = kinetic energy + e.K_p e / 2 falls by
    dq.K_v dq (Takegaki and Arimoto, 1981; LaSalle). In motion the error is that of the PD less gravity.

    No mutable state.
    """

    def __init__(self, pd: JointPD, model: Model) -> None:
        self.pd = pd
        self.model = model

    @classmethod
    def build(cls, settings: PDGravitySettings, context: LawContext) -> JointPDGravity:
        """Make the law and its model from their section of the configuration."""
        model = build_model(settings.model, context.platform, context.leg_spin)
        return cls(JointPD.build(settings, context), model)

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular."""
        weight = inverse_dynamics_kernel(
            self.model.constants, self.model.code, state.p, state.R, _REST, _REST, NO_WRENCH
        )
        return Effort(self.pd.effort(state, reference, shortfall).tau + weight)
