"""PD on leg lengths with gravity compensation (control notes, sections 6.1.1 and 6.1.3 B: G in the loop)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed, reals_at
from hil.control.law import LawContext, ModelBasedSettings
from hil.control.pd import GAINS, DriveGains, JointPD, pd_force
from hil.control.pointed_law import SEEN, PointedLaw
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, inverse_dynamics_kernel


class PDGravitySettings(DriveGains, ModelBasedSettings):
    """Decentralised PD on leg lengths with gravity compensation at the measured pose.

    Of the model, only gravity is used.
    """

    uncertified = "its energy function decreases only for a reference at rest; in motion it may grow"
    law: Literal["pd_gravity"]

    def build(self, context: LawContext) -> JointPDGravity:
        """Build the control law from these settings."""
        return JointPDGravity(self.pd(), context.model(self.model))


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    c, none = reals_at(constants, SIZE), np.zeros(6)
    weight = inverse_dynamics_kernel(c, code, tick.p, tick.R, none, none, none)
    for i in range(6):
        tick.tau_law[i] = pd_force(k, tick, i) + weight[i]
    return 0


class JointPDGravity(PointedLaw):
    """tau = K_p (q_d - q) + K_v (dq_d - dq) + m ddq_d + J^-T G, J and G at the measured pose.

    With an exact G a reference at rest is reached without error: V = kinetic energy + e.K_p e / 2 decreases
    by dq.K_v dq (Takegaki and Arimoto, 1981; LaSalle). In motion the error is that of the PD without gravity.
    tau is NaN where J is singular.
    """

    dtype = GAINS
    fill = _fill

    def __init__(self, pd: JointPD, model: Model) -> None:
        super().__init__(model, *pd.gains.item())
