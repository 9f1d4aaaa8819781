"""Feed-forward of the inverse dynamics along the reference, and PD on leg lengths (control notes, 6.1.2)."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import data_at, pointed, reals_at
from drivers.errors import ConfigurationError
from hil.control.law import LawContext, ModelBasedSettings, per_leg
from hil.control.pd import GAINS as PD_GAINS
from hil.control.pd import JointPD, LegGains, pd_force
from hil.control.pointed_law import SEEN, PointedLaw
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, inverse_dynamics_kernel
from hil.trajectory.path import PoseSample

GAINS = np.dtype(
    [*PD_GAINS.descr, ("period_s", "<f8"), ("preview_s", "<f8"), ("table", "<i8"), ("rows", "<i8")]
)
"""Those of the PD; the table's times; its address, 0 for online, and the number of its rows."""
ENDLESS = (
    "offline needs a reference that ends, because its forces are computed before the run, allowed: online, "
    "or a reference with duration_s or periods"
)


class FeedforwardPDSettings(LegGains, ModelBasedSettings):
    """Inverse dynamics along the reference, and PD on leg lengths."""

    uncertified = "its error dynamics J^-T M J^-1 E'' + K_v E' + K_p E = 0 change with the pose"
    law: Literal["feedforward_pd"]
    evaluation: Literal["online", "offline"] = "online"
    """Forces of the reference: computed at each tick, or as a table before the run."""

    @property
    def endless(self) -> tuple[str, str] | None:
        """The table needs an end."""
        return ("evaluation", ENDLESS) if self.evaluation == "offline" else None

    def build(self, context: LawContext) -> FeedforwardPD:
        """Return the law, offline with its table.

        Raises ConfigurationError where the table would have no end.
        """
        model = context.model(self.model)
        table = tabulate(model, context) if self.evaluation == "offline" else None
        pd = JointPD(per_leg(self.kp_N_m), per_leg(self.kv_N_s_m), np.zeros(6))
        return FeedforwardPD(pd, model, context.period_s, table, context.preview_s)


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, constants: int, code: int, tick: Any) -> int:
    feedforward, place = np.empty(6), np.rint((tick.t_d - k.preview_s) / k.period_s)
    if 0.0 <= place < k.rows and place * k.period_s + k.preview_s == tick.t_d:
        feedforward[:] = reals_at(k.table + 48 * int(place), 6)
    else:
        wrench = np.zeros(6)
        if k.table == 0:
            wrench[:] = tick.wrench
        c = reals_at(constants, SIZE)
        feedforward[:] = inverse_dynamics_kernel(
            c, code, tick.p_d, tick.R_d, tick.twist_d, tick.dtwist_d, wrench
        )
    for i in range(6):
        tick.tau_law[i] = pd_force(k, tick, i) + feedforward[i]
    return 0


class FeedforwardPD(PointedLaw):
    """tau = tau_ff + K_v (dq_d - dq) + K_p (q_d - q), tau_ff = J^-T (M dtwist_d + H + G - wrench) + friction.

    All of tau_ff is of the reference, not of the measured pose. With an exact model and q near q_d the error
    follows J^-T M J^-1 E'' + K_v E' + K_p E = 0, E = q_d - q: coupled and different in each pose.

    Offline, tau_ff is a table of the whole trajectory at the ticks of the loop, made before the run; on the
    way to the trajectory, while stopping and at rest it is computed as online. An external load is not
    known beforehand: offline leaves it out. Without one, both give the same bits. tau is NaN where J is
    singular on the reference.
    """

    dtype = GAINS
    fill = _fill

    def __init__(
        self, pd: JointPD, model: Model, period_s: float, table: Array | None = None, preview_s: float = 0.0
    ) -> None:
        """Take tau_ff (n, 6) N at the times k period_s + preview_s as table, or None for online."""
        super().__init__(model, *pd.gains.item(), period_s, preview_s)
        self.table = table

    @property
    def table(self) -> Array | None:
        """tau_ff (n, 6) N at the times k period_s + preview_s; None: it is computed online."""
        return self._table

    @table.setter
    def table(self, table: Array | None) -> None:
        self._table = None if table is None else np.ascontiguousarray(table, np.float64)
        self.gains["table"] = 0 if self._table is None else data_at(self._table)
        self.gains["rows"] = 0 if self._table is None else len(self._table)


def tau_ff(model: Model, reference: PoseSample, wrench: Array) -> Array:
    """Return J^-T (M dtwist_d + H + G - wrench) + friction at the reference, (6,) N."""
    return inverse_dynamics_kernel(model.constants, model.code, *reference, wrench)


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
    table = np.array([tau_ff(model, trajectory.sample(t), ZERO6) for t in times])
    table.flags.writeable = False
    return table
