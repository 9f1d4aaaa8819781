"""Section `estimation`: where the State comes from, and the external load on the platform."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from drivers.section import Section
from hil.config.delay import ForceDelay
from hil.config.model import ModelSettings
from hil.config.values import NonNegative, Positive


class WrenchSettings(ForceDelay):
    """Where the external wrench of the State comes from; laws with a model compensate it."""

    source: Literal["none", "observer", "sensor"] = "none"
    """`observer`: from the forces sent and the motion they caused. `sensor`: the wrench of `sensors`."""
    bandwidth_Hz: Annotated[float, Field(gt=0, le=100)] = 15.0
    """Of the observer. More is faster, noisier, and less forgiving of wrong delays and masses."""
    model: ModelSettings = ModelSettings()
    """Of the observer: what it does not hold, friction included, counts as external."""


class FusionSettings(Section):
    """The error-state Kalman filter of `hil.estimation.fusion`: what it believes of legs and motion."""

    model: ModelSettings = ModelSettings()
    """Turns leg forces into the acceleration that carries the pose from tick to tick."""
    length_std_m: Positive | None = None
    """Noise of a leg length, one standard deviation. Default: the steps of the virtual plant's encoders and
    of the feedback, each divided by sqrt(12); without a plant monitor.length_noise_m divided by sqrt(12)."""
    rate_std_m_s: Positive | None = None
    """Noise of a leg rate. Default: monitor.rate_noise_m_s divided by sqrt(12). Skew and scale of the rates
    come on top: monitor.rate_skew_us and rate_error_percent, each divided by sqrt(3)."""
    latch_std_us: NonNegative = 0.0
    """How far the instants at which the drives latch are from even, beyond the known lateness of a tick."""
    acceleration_noise_m_s2_sqrtHz: Positive = 0.01
    """Density of what the model's linear acceleration is wrong by, as white noise."""
    angular_acceleration_noise_rad_s2_sqrtHz: Positive = 0.01
    """The same of the angular acceleration."""
    leg_force_std_N: NonNegative | None = None
    """Force along a leg that neither model nor drives know, root of its mean square: friction, inertia of
    motor and screw. Default: friction as for monitor.friction_N, less that of the model. 0: there is none."""
    leg_force_time_ms: Positive = 100.0
    """Correlation time of that force. Dry friction that turns r times a second has 500 / r."""
    gate_std: Annotated[float, Field(ge=3)] = 6.0
    """A measurement further from its prediction than this many standard deviations is left out."""
    encoder_slip_m: Positive = 2e-4
    """A length that alone contradicts its prediction by more than this, three ticks in a row, is a slip."""
    may_lose_legs: list[Annotated[int, Field(ge=0, le=5)]] = []
    """Legs whose encoder may be lost: the run goes on without it. All others fault as ever."""
    lost_at_once: Annotated[int, Field(ge=1, le=6)] = 1
    """More lost encoders than this at once fault."""
    tracker_gap_max_ms: Positive = 100.0
    """With a leg lost, longer than this without a useful sample of the tracker, the only hold, faults."""
    position_std_max_m: Positive = 5e-3
    """The filter's own standard deviation of the platform's position that faults, over all directions."""
    imu_biases: bool = True
    """Estimate the biases of the IMU, too."""
    gyro_bias_walk_rad_s_sqrts: NonNegative = 1e-5
    """How fast the bias of the angular rate drifts: standard deviation after one second."""
    accelerometer_bias_walk_m_s2_sqrts: NonNegative = 1e-4
    """How fast the bias of the specific force drifts."""

    @field_validator("may_lose_legs")
    @classmethod
    def _each_once(cls, legs: list[int]) -> list[int]:
        if len(set(legs)) != len(legs):
            raise ValueError(f"a leg twice, allowed: each of 0 to 5 once, given: {legs}")
        return legs


class EstimationSettings(Section):
    """How the state of the platform is estimated."""

    pose: Literal["legs", "fused"] = "legs"
    """`legs`: forward kinematics of six lengths. `fused`: legs, model and the poses of section `sensors`."""
    fusion: FusionSettings = FusionSettings()
    """For pose `fused`."""
    wrench: WrenchSettings = WrenchSettings()
    """The external load on the platform."""
