"""Section `estimation`: how the platform's pose, twist and external load are estimated."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from drivers.section import Section
from hil.config.delay import ForceDelay
from hil.config.model import ModelSettings
from hil.config.values import NonNegative, Positive


class WrenchSettings(ForceDelay):
    """Source of the estimated external wrench; laws with a model compensate the wrench."""

    source: Literal["none", "observer", "sensor"] = "none"
    """`observer`: from the forces sent and the resulting motion. `sensor`: the wrench of `sensors`."""
    forces: Literal["sent", "sensors"] = "sent"
    """Forces that the observer takes: those sent, or those of the load cells `sensors.forces`, which contain
    neither friction nor inertia of the drives."""
    bandwidth_Hz: Annotated[float, Field(gt=0, le=100)] = 15.0
    """Bandwidth of the observer. A larger value is faster, noisier, and more sensitive to wrong delays and
    masses."""
    model: ModelSettings | None = None
    """Model of the observer; forces outside the model, friction included, count as external. Default: the
    model of the controller, else the full model."""


class FusionSettings(Section):
    """Error-state Kalman filter of `hil.estimation.fusion`: its assumptions about legs and motion."""

    model: ModelSettings = ModelSettings()
    """Model that turns leg forces into the acceleration, which predicts the pose of the next tick."""
    length_std_m: Positive | None = None
    """Standard deviation of the noise of a leg length. Default: the resolution of the virtual plant's
    encoders and of the feedback, each / sqrt(12); without a plant monitor.length_noise_m / sqrt(12)."""
    rate_std_m_s: Positive | None = None
    """Standard deviation of the noise of a leg rate. Default: monitor.rate_noise_m_s / sqrt(12). Skew and
    scale of the rates are added: monitor.rate_skew_us and rate_error_percent, each / sqrt(3)."""
    latch_std_us: NonNegative = 0.0
    """Standard deviation of the drives' sampling instants, beyond the known lateness of a tick."""
    acceleration_noise_m_s2_sqrtHz: Positive = 0.01
    """Error of the model's linear acceleration, as a density of white noise."""
    angular_acceleration_noise_rad_s2_sqrtHz: Positive = 0.01
    """Error of the model's angular acceleration, as a density of white noise."""
    leg_force_std_N: NonNegative | None = None
    """Root mean square of the force along a leg that neither model nor drives know: friction, inertia of
    motor and screw. Default: friction as for monitor.friction_N, minus that of the model. 0: no such
    force."""
    leg_force_time_ms: Positive = 100.0
    """Correlation time of that force. Dry friction that reverses r times a second: 500 / r."""
    gate_std: Annotated[float, Field(ge=3)] = 6.0
    """Outlier limit: a measurement farther from its prediction than this many standard deviations is left
    out."""
    encoder_slip_m: Positive = 2e-4
    """Encoder slip: one length alone differs from its prediction by more than this in three consecutive
    ticks."""
    may_lose_legs: list[Annotated[int, Field(ge=0, le=5)]] = []
    """Legs that may lose their encoder: the run continues without it. A lost encoder of any other leg
    faults."""
    lost_at_once: Annotated[int, Field(ge=1, le=6)] = 1
    """Largest number of encoders lost at once; more fault."""
    tracker_gap_max_ms: Positive = 100.0
    """Longest gap between useful tracker samples while a leg is lost and only the tracker helps; more
    faults."""
    position_std_max_m: Positive = 5e-3
    """Largest standard deviation of the platform's position in the filter, all directions; more faults."""
    imu_biases: bool = True
    """Estimate the IMU biases, too."""
    gyro_bias_walk_rad_s_sqrts: NonNegative = 1e-5
    """Drift of the bias of the angular rate: standard deviation after one second."""
    accelerometer_bias_walk_m_s2_sqrts: NonNegative = 1e-4
    """Drift of the bias of the specific force: standard deviation after one second."""

    @field_validator("may_lose_legs")
    @classmethod
    def _each_once(cls, legs: list[int]) -> list[int]:
        if len(set(legs)) != len(legs):
            raise ValueError(f"a leg twice, allowed: each of 0 to 5 once, given: {legs}")
        return legs


class EstimationSettings(Section):
    """Estimation of the platform's pose, twist and external wrench."""

    pose: Literal["legs", "fused"] = "legs"
    """`legs`: forward kinematics of the six lengths. `fused`: legs, model and the poses of section
    `sensors`."""
    fusion: FusionSettings = FusionSettings()
    """For pose `fused`."""
    wrench: WrenchSettings = WrenchSettings()
    """External load on the platform."""
