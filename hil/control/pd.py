"""Decentralised PD on leg lengths (control notes, section 6.1.1)."""

from __future__ import annotations

from math import sqrt
from typing import Any, Literal

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import pointed
from hil.config.values import NonNegative, Positive, SixNonNegative, SixPositive
from hil.control.law import DesiredLoop, LawContext, LawSettings, per_leg
from hil.control.pointed_law import SEEN, PointedLaw

GAINS = np.dtype([("K_p", "<f8", 6), ("K_v", "<f8", 6), ("m", "<f8", 6)])


class LegGains(LawSettings):
    """Settings: gains of PD control on leg lengths."""

    knob = {"kp_N_m": 2, "kv_N_s_m": 1}
    kp_N_m: Positive | SixPositive
    """Gain: one for all legs, or one per leg."""
    kv_N_s_m: Positive | SixPositive

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float]:
        """Natural frequency, rad/s, and damping ratio of a leg with `leg_mass`, kg, at the largest gains."""
        del mass
        wn = sqrt(np.max(self.kp_N_m) / leg_mass)
        return wn, float(np.max(self.kv_N_s_m) / (2.0 * wn * leg_mass))

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Gains of M E'' + K_v E' + K_p E = 0 with which the heaviest motion has the desired wn and zeta.

        All other motions are faster and better damped.
        """
        return {"kp_N_m": loop.leg_mass * loop.wn**2, "kv_N_s_m": 2.0 * loop.zeta * loop.wn * loop.leg_mass}


class DriveGains(LegGains):
    """Settings of PD control on leg lengths, with acceleration feed-forward of each drive alone."""

    feedforward_mass_kg: NonNegative | SixNonNegative = 0.0
    """m: mass that each drive accelerates along its leg, for drives with dominant gears: rotary inertia times
    (2 pi / lead)^2, and a share of the platform. One for all legs, or one per leg.
    """

    def pd(self) -> JointPD:
        """PD law on leg lengths with these gains."""
        return JointPD(per_leg(self.kp_N_m), per_leg(self.kv_N_s_m), per_leg(self.feedforward_mass_kg))


class PDSettings(DriveGains):
    """Decentralised PD on leg lengths: tau = Kp (q_d - q) + Kv (dq_d - dq) + m ddq_d."""

    uncertified = "its error dynamics change with the pose of the platform"
    law: Literal["pd"]

    def build(self, context: LawContext) -> JointPD:
        """Build the control law from these settings; it needs no model of the robot."""
        del context
        return self.pd()


@helper
def pd_force(k: Any, tick: Any, i: int) -> float:
    """PD force of leg i, N, > 0 extends: K_p (q_d - q) + K_v (dq_d - dq) + m ddq_d."""
    e, de = tick.q_d[i] - tick.q[i], tick.dq_d[i] - tick.dq[i]
    return float(k.K_p[i] * e + k.K_v[i] * de + k.m[i] * tick.ddq_d[i])


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(k: Any, _constants: int, _code: int, tick: Any) -> int:
    for i in range(6):
        tick.tau_law[i] = pd_force(k, tick, i)
    return 0


class JointPD(PointedLaw):
    """tau = K_p (q_d - q) + K_v (dq_d - dq) + m ddq_d, K_p, K_v and m diagonal.

    m is the mass that each drive accelerates along its own leg. Where gears make m dominate the platform,
    m ddq_d is a sufficient feed-forward, and the legs are not coupled (Siciliano, Sciavicco, Villani and
    Oriolo, Robotics, 2009, 8.3). A leg of mass m alone obeys m E'' + K_v E' + K_p E = 0, E = q_d - q.
    m = 0 is the law of the notes.
    """

    dtype = GAINS
    fill = _fill

    def __init__(self, K_p: Array, K_v: Array, m: Array) -> None:
        """PD law with the diagonals K_p (6,) N/m, K_v (6,) N s/m and m (6,) kg."""
        super().__init__(None, K_p, K_v, m)
