"""Feed-forward of the inverse dynamics along the reference, and PD on leg lengths (control notes, 6.1.2)."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.config import FeedforwardPDSettings
from hil.control.law import LawContext, per_leg
from hil.control.model import build_model
from hil.control.pd import JointPD
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.signals import NO_WRENCH, Effort, Reference, State
from hil.trajectory import PoseSample

ENDLESS = (
    "offline needs a reference that ends, because its forces are computed before the run, allowed: online, "
    "or a reference with duration_s or periods"
)


class FeedforwardPD:
    """tau = tau_ff + K_v (dq_d - dq) + K_p (q_d - q), tau_ff = J^-T (M dtwist_d + H + G - wrench) + friction.

    All of tau_ff is of the reference, not of the measured pose. With an exact model and q near q_d the error
    follows J^-T M J^-1 E'' + K_v E' + K_p E = 0, E = q_d - q: coupled and different in each pose.

    Offline, tau_ff is a table of the whole trajectory at the ticks of the loop, made before the run; on the
    way to the trajectory, while stopping and at rest it is computed as online. An external load is not
    known beforehand: offline leaves it out. Without one, both give the same bits.

    No mutable state.
    """

    def __init__(
        self, pd: JointPD, model: Model, period_s: float, table: Array | None = None, preview_s: float = 0.0
    ) -> None:
        """Take tau_ff (n, 6) N at the times k period_s + preview_s as table, or None for online."""
        self.pd = pd
        self.model = model
        self.period_s = period_s
        self.table = table
        self.preview_s = preview_s

    @classmethod
    def build(cls, settings: FeedforwardPDSettings, context: LawContext) -> FeedforwardPD:
        """Make the law, its model and, offline, its table from their section of the configuration.

        Raises ConfigurationError where the table would have no end.
        """
        model = build_model(settings.model, context.platform, context.leg_spin)
        table = tabulate(model, context) if settings.evaluation == "offline" else None
        pd = JointPD(per_leg(settings.kp_N_m), per_leg(settings.kv_N_s_m), np.zeros(6))
        return cls(pd, model, context.period_s, table, context.preview_s)

    def reset(self) -> None:
        """Nothing is accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N; NaN where J is singular on the reference."""
        feedforward = self._tabulated(reference.t)
        if feedforward is None:
            wrench = state.wrench if self.table is None else NO_WRENCH
            feedforward = tau_ff(self.model, reference, wrench)
        return Effort(feedforward + self.pd.effort(state, reference, shortfall).tau)

    def _tabulated(self, t: float) -> Array | None:
        """Return the table's row for the time t; None where t is not one of its times."""
        if self.table is None or math.isnan(t):
            return None
        k = round((t - self.preview_s) / self.period_s)
        listed = 0 <= k < len(self.table) and k * self.period_s + self.preview_s == t
        return self.table[k] if listed else None


def tau_ff(model: Model, reference: Reference | PoseSample, wrench: Array) -> Array:
    """Return J^-T (M dtwist_d + H + G - wrench) + friction at the reference, (6,) N."""
    return inverse_dynamics_kernel(
        model.constants, model.code, reference.p, reference.R, reference.twist, reference.dtwist, wrench
    )


def tabulate(model: Model, context: LawContext) -> Array:
    """Return tau_ff without load at k period_s + preview_s, k = 0, 1, ... to the trajectory's end, (n, 6) N.

    Raises ConfigurationError for a trajectory without end.
    """
    trajectory, period_s = context.trajectory, context.period_s
    if trajectory.duration_s is None:
        raise ConfigurationError(f"controller.evaluation: {ENDLESS}")
    times = [
        k * period_s + context.preview_s for k in range(math.floor(trajectory.duration_s / period_s) + 1)
    ]
    table = np.array([tau_ff(model, trajectory.sample(t), NO_WRENCH) for t in times])
    table.flags.writeable = False
    return table
