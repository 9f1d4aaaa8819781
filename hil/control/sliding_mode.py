"""Sliding mode control on the leg lengths (Slotine and Li, Applied Nonlinear Control, 1991, chapter 7).

::

    e = q_d - q,  s = de + lambda e
    ddq* = ddq_d + lambda de + k sat(s / phi)
    tau  = J^-T [M J^-1 (ddq* - J_dot twist) + H + G - wrench] + friction

Stability: the model error is an acceleration d of a leg, and the closed loop is
ds/dt = d - k sat(s / phi). For |d| <= D, k = D + eta, outside the boundary layer |s| <= phi

    d/dt s^2 / 2 = s d - k |s| <= -eta |s|

so s reaches the layer within |s(0)| / eta and stays inside. Inside, de + lambda e = s is a first-order lag:
|e| <= phi / lambda for every d. D follows from `UncertaintySettings`. Cost, and smallest useful layer:
docs/theory/robust.md. With phi = 0 the law switches, and the force chatters.
"""

from __future__ import annotations

from math import inf
from typing import Any, Literal

import numpy as np

from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed
from hil.config.values import NonNegative, Positive
from hil.control.inverse_dynamics import linearise
from hil.control.law import DesiredLoop, ErrorDynamics, LawContext, ModelBasedSettings
from hil.control.pointed_law import SEEN, PointedLaw
from hil.control.uncertainty import ASSUMED_m_s2, UncertaintySettings

GAINS = np.dtype([("slope", "<f8"), ("k", "<f8"), ("phi", "<f8")])


class SlidingModeSettings(ModelBasedSettings):
    """Sliding mode control of the leg lengths with a boundary layer; sliding variable s = de + lambda e."""

    axes = "joint"
    tuning = ("lambda_rad_s and boundary_layer_m_s", "reduce lambda, increase the layer,")
    knob = {"lambda_rad_s": 1, "boundary_layer_m_s": -1}
    law: Literal["sliding_mode"]
    lambda_rad_s: Positive
    """Slope of the sliding surface; on the surface an error decays as exp(-lambda t)."""
    uncertainty: UncertaintySettings
    """Model error; its bound plus the reaching acceleration is the switching gain k."""
    reaching_m_s2: Positive
    """Smallest rate at which s approaches the boundary layer under any allowed uncertainty."""
    boundary_layer_m_s: NonNegative | None = None
    """phi: the law is linear for |s| < phi; |e| <= phi / lambda. Default k / lambda, which gives the
    linear law two poles at lambda. 0: the law switches and chatters.
    """

    @property
    def switching_gain(self) -> float:
        """Switching gain k, m/s^2: bound of the uncertainty plus the reaching acceleration."""
        return self.uncertainty.bound(self.reaching_m_s2)

    @property
    def boundary_layer(self) -> float:
        """Boundary layer phi, m/s, as configured or by default k / lambda."""
        phi = self.boundary_layer_m_s
        return self.switching_gain / self.lambda_rad_s if phi is None else phi

    def build(self, context: LawContext) -> SlidingMode:
        """Build the control law from these settings."""
        model = context.model(self.model)
        return SlidingMode(model, self.lambda_rad_s, self.switching_gain, self.boundary_layer)

    def error_dynamics(self) -> ErrorDynamics:
        """Linear error dynamics inside the boundary layer, and how the law saturates outside."""
        slope, phi = self.lambda_rad_s, self.boundary_layer
        steepness = self.switching_gain / phi if phi > 0.0 else inf
        gains = np.full(6, slope * steepness), np.full(6, slope + steepness)
        return ErrorDynamics(*gains, slope=slope, steepness=steepness, layer=phi)

    def described(self) -> list[str]:
        """Line that `hil check` prints: switching gain, boundary layer, largest leg error inside."""
        phi = self.boundary_layer
        layer = f"boundary layer {phi:.3g} m/s: |e| <= {1e3 * phi / self.lambda_rad_s:.3g} mm"
        return [f"switching gain {self.switching_gain:.3g} m/s^2, {layer}"]

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float]:
        """Natural frequency lambda, rad/s, and damping ratio 1 of the double pole at lambda."""
        del leg_mass, mass
        return self.lambda_rad_s, 1.0

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Keys for the desired loop: default disturbance, two poles at zeta wn inside the boundary layer."""
        return {
            "lambda_rad_s": loop.zeta * loop.wn,
            "uncertainty": {"disturbance_m_s2": ASSUMED_m_s2},
            "reaching_m_s2": ASSUMED_m_s2,
        }


@pointed(record(GAINS), INTEGER, INTEGER, SEEN)
def _fill(g: Any, constants: int, code: int, tick: Any) -> int:
    ddq_star = np.empty(6)
    for i in range(6):
        de = tick.dq_d[i] - tick.dq[i]
        s = de + g.slope * (tick.q_d[i] - tick.q[i])
        switched = s / g.phi if abs(s) < g.phi else np.sign(s)
        ddq_star[i] = tick.ddq_d[i] + g.slope * de + g.k * switched
    linearise(constants, code, tick, ddq_star, tick.wrench)
    return 0


class SlidingMode(PointedLaw):
    """ddq* = ddq_d + lambda de + k sat(s / phi), s = de + lambda e, by exact inverse dynamics.

    e = q_d - q (6,) m; sat(x) is x clamped to -1 .. 1; with phi = 0 it is sgn(s), sgn(0) = 0.
    Gains: lambda in 1/s (``slope``), k in m/s^2 and phi in m/s, the same for all legs.
    """

    dtype = GAINS
    fill = _fill
