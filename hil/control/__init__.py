"""Control laws: one per file, one row in the table of ControllerSettings."""

from typing import Annotated, get_args

from pydantic import Field

from hil.control.cartesian_pd import CartesianPDSettings
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.law import LawSettings
from hil.control.partial_linearisation import PartialLinearisationSettings
from hil.control.pd import PDSettings
from hil.control.pd_gravity import PDGravitySettings
from hil.control.pid import PIDSettings
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.control.state_space import StateSpaceSettings

ControllerSettings = Annotated[
    PDSettings
    | PIDSettings
    | PDGravitySettings
    | CartesianPDSettings
    | FeedforwardPDSettings
    | PoseInverseDynamicsSettings
    | PartialLinearisationSettings
    | InverseDynamicsSettings
    | SlidingModeSettings
    | RobustInverseDynamicsSettings
    | StateSpaceSettings,
    Field(discriminator="law"),
]
"""Section `controller`: one row a law."""

LAWS: dict[str, type[LawSettings]] = {
    get_args(kind.model_fields["law"].annotation)[0]: kind
    for kind in get_args(get_args(ControllerSettings)[0])
}
"""`controller.law` of the configuration -> its settings."""
