"""Control laws: one per file, one row in LAWS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hil.config import ControllerSettings
from hil.control.cartesian_pd import CartesianPD
from hil.control.feedforward_pd import FeedforwardPD
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.control.law import Law, LawContext
from hil.control.partial_linearisation import PartialLinearisation
from hil.control.pd import JointPD
from hil.control.pd_gravity import JointPDGravity
from hil.control.pid import JointPID
from hil.control.pose_inverse_dynamics import PoseInverseDynamics
from hil.control.robust_inverse_dynamics import RobustInverseDynamics
from hil.control.sliding_mode import SlidingMode
from hil.control.state_space import StateSpace

LAWS: dict[str, Callable[[Any, LawContext], Law]] = {
    "pd": JointPD.build,
    "pid": JointPID.build,
    "pd_gravity": JointPDGravity.build,
    "cartesian_pd": CartesianPD.build,
    "feedforward_pd": FeedforwardPD.build,
    "pose_inverse_dynamics": PoseInverseDynamics.build,
    "partial_linearisation": PartialLinearisation.build,
    "inverse_dynamics": JointInverseDynamics.build,
    "sliding_mode": SlidingMode.build,
    "robust_inverse_dynamics": RobustInverseDynamics.build,
    "state_space": StateSpace.build,
}
"""`controller.law` of the configuration -> builder(settings, context)."""


def build_law(settings: ControllerSettings, context: LawContext) -> Law:
    """Return the law that the configuration names."""
    return LAWS[settings.law](settings, context)


__all__ = ["LAWS", "Law", "LawContext", "build_law"]
