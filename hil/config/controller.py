"""Section `controller`: one model a law, told apart by `law`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.config import Section
from hil.config.model import MechanicsSettings, ModelSettings
from hil.config.model_based import ModelBasedSettings
from hil.config.robust import RobustInverseDynamicsSettings, SlidingModeSettings
from hil.config.state_space import StateSpaceSettings
from hil.config.values import (
    NonNegative,
    Positive,
    SixNonNegative,
    SixPositive,
    ThreePositive,
    largest,
)


class LegGains(Section):
    """Gains of a PD on leg lengths."""

    kp_N_m: Positive | SixPositive
    """One for all legs, or one per leg."""
    kv_N_s_m: Positive | SixPositive


class DriveGains(LegGains):
    """A PD on leg lengths, and the acceleration feed-forward of each drive by itself."""

    feedforward_mass_kg: NonNegative | SixNonNegative = 0.0
    """m: what each drive accelerates along its leg, for drives whose gears dominate: rotary inertia times
    (2 pi / lead)^2, and a share of the platform. One for all legs, or one per leg."""


class PDSettings(DriveGains):
    """Decentralised PD on leg lengths: tau = Kp (q_d - q) + Kv (dq_d - dq) + m ddq_d."""

    law: Literal["pd"]


class PIDSettings(DriveGains):
    """Decentralised PID on leg lengths, with an integral that limits do not wind up."""

    law: Literal["pid"]
    ki_N_m_s: Positive | SixPositive
    """Integral gain, force per error and second; one for all legs, or one per leg."""
    integral_limit_N: Positive | SixPositive
    """Largest force of the integral, either way; at least what a leg carries at rest."""
    tracking_time_s: Positive | None = None
    """In which the integral gives back what a limit has taken; default sqrt(kv / ki)."""


class PDGravitySettings(DriveGains, ModelBasedSettings):
    """Decentralised PD on leg lengths, and the forces that hold platform and legs up where they are.

    Of the model, gravity counts.
    """

    law: Literal["pd_gravity"]


class CartesianPDSettings(Section):
    """PD on position and rotation of the platform, found by forward kinematics."""

    law: Literal["cartesian_pd"]
    kp_position_N_m: Positive | ThreePositive
    """One for all axes of the base frame, or one each; so are the others."""
    kv_position_N_s_m: Positive | ThreePositive
    kp_rotation_N_m_rad: Positive | ThreePositive
    kv_rotation_N_m_s_rad: Positive | ThreePositive
    rotation_error: Literal["shortest_turn", "vector_difference"] = "shortest_turn"
    """log(R_d R^T), or the difference of the rotation vectors of the two poses as it is often printed."""
    model: ModelSettings | None = None
    """Its gravity is compensated; default none is."""


class FeedforwardPDSettings(LegGains, ModelBasedSettings):
    """Inverse dynamics along the reference, and PD on leg lengths."""

    law: Literal["feedforward_pd"]
    evaluation: Literal["online", "offline"] = "online"
    """Forces of the reference: computed at each tick, or as a table before the run."""


class ErrorDynamics(Section):
    """Error dynamics e'' + K_D e' + K_P e = 0 of a law that linearises the robot."""

    wn_rad_s: Positive | SixPositive
    """Natural frequency, K_P = wn^2; one for all, or one per leg (in pose space one each for x, y, z and the
    rotation about them)."""
    damping_ratio: Positive = 1.0
    """K_D = 2 zeta wn."""

    @property
    def linear_gains(self) -> tuple[float, float]:
        """K_P in 1/s^2 and K_D in 1/s of the fastest error."""
        w_n = largest(self.wn_rad_s)
        return w_n**2, 2.0 * self.damping_ratio * w_n


class InverseDynamicsSettings(ErrorDynamics, ModelBasedSettings):
    """Exact inverse dynamics in joint space; approximate ones are variants of its model."""

    law: Literal["inverse_dynamics"]


class PoseInverseDynamicsSettings(ErrorDynamics, ModelBasedSettings):
    """Exact inverse dynamics in pose space."""

    law: Literal["pose_inverse_dynamics"]


class PartialLinearisationSettings(ErrorDynamics):
    """Inverse dynamics in joint space without H and external load."""

    law: Literal["partial_linearisation"]
    model: MechanicsSettings = MechanicsSettings()


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
