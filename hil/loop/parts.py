"""The parts of which a cycle is made.

This module only lists the parts; `hil.app.compose` builds them.
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
    """The parts of a cycle: robot, protocol, law, reference, safety, estimators and settings."""

    platform: Platform
    model: Model
    """Loads of the legs and their response to forces, without friction."""
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
    """Settings that the protocol writes to the drives."""
    wrench: ExternalWrench
    operator: OperatorSettings
    """Required actions and set-up speeds of the operator."""
    admission: Admission
    """Checks the rest poses of jogs, and the straight moves."""
    steering: Steering | None = None
    """Takes set-points, where the reference is live."""
    last_pose: LastPose | None = None
    """Parked leg lengths, for drives that lose count of motor turns at power-off."""
    sensors: SensorProtocol | None = None
    fusion: FusedEstimator | None = None
    """Fusion filter, which takes over once the legs have given a pose; None: the pose comes from the legs
    alone."""
    buses: tuple[str, ...] = ()
    """Channel and legs of each bus, if there are several."""
    predictor: Predictor | None = None
    """Predicts state and reference at the time when the law's force will act; None: no prediction."""
    learned: LearnedForces | None = None
    """Forces learned from earlier runs of this trajectory."""
