"""PD on leg lengths with gravity compensation (control notes, sections 6.1.1 and 6.1.3 B: G in the loop)."""

from __future__ import annotations

from typing import Literal

from drivers.arrays import ZERO6
from drivers.tick_columns import Record
from hil.control.law import LawContext, Memoryless, ModelBasedSettings
from hil.control.pd import DriveGains, JointPD
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel


class PDGravitySettings(DriveGains, ModelBasedSettings):
    """Decentralised PD on leg lengths, and the forces that hold platform and legs up where they are.

    Of the model, gravity counts.
    """

    uncertified = "its energy function belongs to a reference at rest; in motion it may grow"
    law: Literal["pd_gravity"]

    def build(self, context: LawContext) -> JointPDGravity:
        """Return the law."""
        return JointPDGravity(self.pd(), context.model(self.model))


class JointPDGravity(Memoryless):
    """tau = K_p (q_d - q) + K_v (dq_d - dq) + m ddq_d + J^-T G, J and G at the measured pose.

    With an exact G a reference at rest is reached without error: V = kinetic energy + e.K_p e / 2 falls by
    dq.K_v dq (Takegaki and Arimoto, 1981; LaSalle). In motion the error is that of the PD less gravity.
    """

    def __init__(self, pd: JointPD, model: Model) -> None:
        self.pd = pd
        self.model = model

    def effort(self, tick: Record) -> None:
        """Fill tau_law; NaN where J is singular."""
        self.pd.effort(tick)
        model = self.model
        weight = inverse_dynamics_kernel(
            model.constants, model.code, tick["p"], tick["R"], ZERO6, ZERO6, ZERO6
        )
        tick["tau_law"] += weight
