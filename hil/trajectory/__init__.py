"""Reference trajectories: pure functions of time that give pose, twist and its rate.

Deterministic to the bit, no clock; only `build` and `sampled` read the configuration or a file, and only
while the trajectory is built. A new kind is one file and one row in `build.BUILDERS`.
"""

from hil.trajectory.build import build_trajectory
from hil.trajectory.holding import HoldTrajectory, hold
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.move import GeodesicMove, quintic_move
from hil.trajectory.path import PoseSample, Trajectory, axis_limits, six_words
from hil.trajectory.piecewise import PiecewisePolynomial
from hil.trajectory.sampled import sampled_trajectory
from hil.trajectory.sinusoids import SinusoidTrajectory
from hil.trajectory.stopping import StoppingTrajectory
from hil.trajectory.time_optimal import plan
from hil.trajectory.waypoints import waypoint_trajectory

__all__ = [
    "GeodesicMove",
    "HoldTrajectory",
    "LiveTrajectory",
    "PiecewisePolynomial",
    "PoseSample",
    "SinusoidTrajectory",
    "StoppingTrajectory",
    "Trajectory",
    "axis_limits",
    "build_trajectory",
    "hold",
    "plan",
    "quintic_move",
    "sampled_trajectory",
    "six_words",
    "waypoint_trajectory",
]
