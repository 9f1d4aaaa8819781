"""What a cycle is made of.

It only names the parts, `hil.app.compose` makes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.arrays import Array
from drivers.family import Family
from drivers.protocol import DriveSetup
from drivers.sensors import SensorProtocol
from hil.config.limits import ReactionSettings
from hil.config.running import EngageSettings, OperatorSettings
from hil.control.law import Law
from hil.estimation.external_wrench import ExternalWrench
from hil.estimation.predictor import Predictor
from hil.loop.admission import Admission, Steering
from hil.loop.homing import LastPose
from hil.loop.reference import LearnedForces
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.safety import Safety
from hil.trajectory.path import Trajectory

if TYPE_CHECKING:
    from hil.estimation.fusion import FusedEstimator  # its kernels are compiled only for who fuses


@dataclass(frozen=True)
class Parts:
    """What a cycle is made of."""

    platform: Platform
    model: Model
    """What legs bear and how they yield to forces, without friction."""
    protocol: Family
    law: Law
    trajectory: Trajectory
    safety: Safety
    engage: EngageSettings
    reactions: ReactionSettings
    home_p: Array
    home_R: Array
    rate_Hz: float
    setup: DriveSetup
    """What the protocol sets in the drives."""
    wrench: ExternalWrench
    operator: OperatorSettings
    """What the operator has to do."""
    admission: Admission
    """Judges where a jog would come to rest, and the straight ways."""
    steering: Steering | None = None
    """What takes set-points, where the reference is live."""
    last_pose: LastPose | None = None
    """Where the legs were parked, for drives that forget their turns at power-off."""
    sensors: SensorProtocol | None = None
    fusion: FusedEstimator | None = None
    """Gives the pose once the legs have; None: the legs alone do."""
    buses: tuple[str, ...] = ()
    """Channel and legs of each bus, where there are several."""
    predictor: Predictor | None = None
    """For a law that reads state and reference at the instant at which its force acts."""
    learned: LearnedForces | None = None
    """What earlier runs of this trajectory have taught."""
