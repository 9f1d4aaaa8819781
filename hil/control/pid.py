"""Decentralised PID on leg lengths (control notes, section 6.1.1, with an integral)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed
from hil.config.values import Positive, SixPositive
from hil.control.law import DesiredLoop, LawContext, per_leg
from hil.control.pd import GAINS as PD_GAINS
from hil.control.pd import DriveGains, JointPD, pd_force
from hil.control.pointed_law import SEEN, PointedLaw

GAINS = np.dtype([*PD_GAINS.descr, *((name, "<f8", 6) for name in ("K_i_T", "share", "xi_max", "xi"))])
"""Layout: gains of the PD; K_i times the period; share of the shortfall for xi; limit of xi; xi."""


class PIDSettings(DriveGains):
    """Decentralised PID on leg lengths with anti-windup."""

    uncertified = "its error dynamics change with the pose of the platform, and its integral is not measured"
    knob = {**DriveGains.knob, "ki_N_m_s": 3, "tracking_time_s": -1}
    law: Literal["pid"]
    ki_N_m_s: Positive | SixPositive
    """Integral gain, force per error and second; one for all legs, or one per leg."""
    integral_limit_N: Positive | SixPositive
    """Largest force of the integral, either sign; at least the load of a leg at rest."""
    tracking_time_s: Positive | None = None
    """Time constant of the back-calculation while a limit reduces the force; default sqrt(kv / ki)."""

    def build(self, context: LawContext) -> JointPID:
        """Build the control law from these settings; it needs no model of the robot."""
        K_i, xi_max = per_leg(self.ki_N_m_s), per_leg(self.integral_limit_N)
        return JointPID(self.pd(), K_i, xi_max, context.period_s, self.tracking_time_s)

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Gains of the PD, and a tenth of the stability limit of K_i (Routh: K_i m < K_p K_v)."""
        return {
            **super().derived(loop),
            "ki_N_m_s": 0.2 * loop.zeta * loop.leg_mass * loop.wn**3,
            "integral_limit_N": loop.force_limit,
        }


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, _constants: int, _code: int, tick: Any) -> int:
    """Advance the integral force xi by one period and add it to the PD's force."""
    for i in range(6):
        value = k.xi[i] + k.K_i_T[i] * (tick.q_d[i] - tick.q[i]) + k.share[i] * tick.shortfall[i]
        k.xi[i] = min(max(value, -k.xi_max[i]), k.xi_max[i])
        tick.tau_law[i] = pd_force(k, tick, i) + k.xi[i]
    return 0


class JointPID(PointedLaw):
    """tau = K_p e + K_v de + m ddq_d + xi, dxi/dt = K_i e + shortfall / T_t, |xi| <= xi_max; e = q_d - q.

    The integral removes the steady error that a PD has under a constant load. While a limit reduces the
    force, ``shortfall``, the force sent minus the force requested, drives xi until the law requests no more
    than the limit (back-calculation: Astrom and Hagglund, PID Controllers, 1995, 3.5; by default with their
    T_t = sqrt(T_i T_d) = sqrt(K_v / K_i)). Integration by Euler's rule with the loop's period. A T_t below
    one period counts as one period.

    Mutable state: ``xi``; `reset` sets it to zero. The cycle's entry stays bumpless: its offset
    carries the load while it fades, and the integral takes over.
    """

    dtype = GAINS
    fill = _fill

    def __init__(
        self, pd: JointPD, K_i: Array, xi_max: Array, period_s: float, T_t: float | None = None
    ) -> None:
        """PID law from a PD law, integral gain K_i (6,) N/(m s), limit xi_max (6,) N, time constant T_t s."""
        tracking = np.sqrt(pd.gains["K_v"] / K_i) if T_t is None else np.full(6, T_t)
        share = np.minimum(period_s / tracking, 1.0)
        super().__init__(None, *pd.gains.item(), period_s * K_i, share, xi_max)

    def reset(self) -> None:
        """Set the integral force xi (6,) to zero."""
        self.xi[:] = 0.0

    @property
    def xi(self) -> Array:
        """Integral force (6,) N; a view of the law's memory, which changes with it."""
        integral: Array = self.gains["xi"]
        return integral
