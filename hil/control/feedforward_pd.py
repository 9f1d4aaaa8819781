"""Inverse dynamics feed-forward along the reference, and PD on leg lengths (control notes, 6.1.2)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed, reals_at
from hil.control.law import LawContext, ModelBasedSettings, per_leg
from hil.control.pd import GAINS as PD_GAINS
from hil.control.pd import JointPD, LegGains, pd_force
from hil.control.pointed_law import SEEN, PointedLaw
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, inverse_dynamics_kernel

GAINS = np.dtype([*PD_GAINS.descr, ("loaded", "<i8")])
"""Layout of the gains: those of the PD; loaded: 1 if the feed-forward includes the external wrench."""


class FeedforwardPDSettings(LegGains, ModelBasedSettings):
    """Feed-forward by inverse dynamics along the reference, and PD control of the leg lengths."""

    uncertified = "its error dynamics J^-T M J^-1 E'' + K_v E' + K_p E = 0 change with the pose"
    law: Literal["feedforward_pd"]
    evaluation: Literal["online", "offline"] = "online"
    """`offline`: feed-forward of the reference alone, as if computed before the run; `online`: it includes
    the external wrench. Both are computed in each tick.
    """

    def build(self, context: LawContext) -> FeedforwardPD:
        """Build the control law from these settings."""
        pd = JointPD(per_leg(self.kp_N_m), per_leg(self.kv_N_s_m), np.zeros(6))
        return FeedforwardPD(pd, context.model(self.model), loaded=self.evaluation == "online")


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    wrench = np.zeros(6)
    if k.loaded:
        wrench[:] = tick.wrench
    c = reals_at(constants, SIZE)
    feedforward = inverse_dynamics_kernel(c, code, tick.p_d, tick.R_d, tick.twist_d, tick.dtwist_d, wrench)
    for i in range(6):
        tick.tau_law[i] = pd_force(k, tick, i) + feedforward[i]
    return 0


class FeedforwardPD(PointedLaw):
    """tau = tau_ff + K_v (dq_d - dq) + K_p (q_d - q), tau_ff = J^-T (M dtwist_d + H + G - wrench) + friction.

    tau_ff is evaluated on the reference, not at the measured pose. With an exact model and q near q_d the
    error E = q_d - q obeys J^-T M J^-1 E'' + K_v E' + K_p E = 0, which is coupled and depends on the pose.

    tau is NaN where J is singular on the reference.
    """

    dtype = GAINS
    fill = _fill

    def __init__(self, pd: JointPD, model: Model, *, loaded: bool) -> None:
        """Law from a PD and a model; with `loaded` the feed-forward tau_ff includes the external wrench."""
        super().__init__(model, *pd.gains.item(), loaded)
