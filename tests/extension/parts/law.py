"""Two laws of a user."""

from math import sqrt
from typing import Any, Literal

from hil.config.values import Positive
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.control.law import DesiredLoop, ErrorGains, LawContext, ModelBasedSettings, per_leg
from hil.control.pd import JointPD
from hil.control.pd_gravity import JointPDGravity


class CriticalSettings(ModelBasedSettings):
    """PD with gravity compensation whose damping follows from stiffness and mass."""

    uncertified = "nobody has proven anything of it"
    law: Literal["critical"]
    stiffness_N_m: Positive
    mass_kg: Positive = 1600.0

    def build(self, context: LawContext) -> JointPDGravity:
        damping = 2.0 * sqrt(self.stiffness_N_m * self.mass_kg)
        pd = JointPD(per_leg(self.stiffness_N_m), per_leg(damping), per_leg(0.0))
        return JointPDGravity(pd, context.model(self.model))

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        return {"stiffness_N_m": loop.leg_mass * loop.wn**2, "mass_kg": loop.leg_mass}


class SlowSettings(ErrorGains, ModelBasedSettings):
    """Inverse dynamics at half of the stated frequency."""

    law: Literal["slow"]
    factor: Positive

    def gains(self):
        K_P, K_D = super().gains()
        return K_P / 4.0, K_D / 2.0

    def build(self, context: LawContext) -> JointInverseDynamics:
        return JointInverseDynamics(context.model(self.model), *self.gains())
