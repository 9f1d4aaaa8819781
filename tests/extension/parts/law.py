"""A law of a user."""

from math import sqrt
from typing import Any, Literal

from hil.config.values import Positive
from hil.control.law import DesiredLoop, LawContext, ModelBasedSettings, per_leg
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
