"""Configuration section `sensors`."""

from math import inf, radians
from typing import TYPE_CHECKING, Annotated, Literal, Union

from pydantic import Field, field_validator

from drivers.config import Above0, Name, refuse_twice
from drivers.registry import sections
from drivers.section import Section
from drivers.sensing.calibration import (
    Calibration,
    ForceCalibration,
    ImuCalibration,
    InclinationCalibration,
    LengthCalibration,
    TrackerCalibration,
)
from drivers.sensing.family import SensorFamily
from drivers.sensing.stamped import StampedSensors

Node = Annotated[int, Field(ge=1, le=127)]
SENSORS = sections("hil.sensors", SensorFamily, "protocol")  # type: ignore[type-abstract]
"""`device.protocol` of a sensor -> its section."""

GYRO_BIAS_STD_rad_s = 0.05
"""Standard deviation of the unknown bias of a gyroscope."""

if TYPE_CHECKING:
    AnySensor = SensorFamily
else:
    AnySensor = Annotated[Union[tuple(SENSORS.values())], Field(discriminator="protocol")]  # noqa: UP007


class SensorRole(Section):
    """Settings that every sensor has."""

    rate_Hz: Above0
    """Samples per second."""
    time_std_ms: Annotated[float, Field(ge=0)] = 0.1
    """Standard deviation of the error of its samples' instants."""
    channel: Name | None = None
    """Its channel of `bus.channels`; default: the first."""
    device: AnySensor = StampedSensors()
    """The device, by the family that reads its frames: its own keys, and `protocol`."""
    calibration: Calibration = Calibration()
    """Errors of the sensor that are taken off its samples."""

    @property
    def nodes(self) -> tuple[int, ...]:
        """Node number of each device."""
        return (self.node_id,) if hasattr(self, "node_id") else tuple(getattr(self, "node_ids", ()))

    @property
    def std(self) -> tuple[float, ...]:
        """Standard deviations, SI, by which its quantities may differ from the legs; inf: not compared."""
        return (inf,) * 6


class TrackerSettings(SensorRole):
    """A device that measures the platform's pose from outside: optical, laser, camera."""

    node_id: Node = 7
    calibration: TrackerCalibration = TrackerCalibration()
    rate_Hz: Above0 = 200.0
    """Samples per second, at most one per tick."""
    position_std_m: Above0 = 1e-3
    """Standard deviation of the noise of each coordinate."""
    orientation_std_deg: Above0 = 0.1
    """Standard deviation of the noise of the orientation about each axis."""
    latency_max_ms: Above0 = 20.0
    """Largest age of a sample; an older one is refused. Each millisecond costs the filter memory and time."""

    @property
    def std(self) -> tuple[float, ...]:
        """Of position and orientation."""
        return (self.position_std_m,) * 3 + (radians(self.orientation_std_deg),) * 3


class ImuSettings(SensorRole):
    """An inertial measurement unit on the platform, its values reduced to the platform origin."""

    node_id: Node = 8
    calibration: ImuCalibration = ImuCalibration()
    rate_Hz: Above0 = 500.0
    """Samples per second, at most one per tick."""
    angular_rate_std_rad_s: Above0 = 2e-3
    specific_force_std_m_s2: Above0 = 0.05

    @property
    def std(self) -> tuple[float, ...]:
        """Of the angular rate, with an unknown bias."""
        return (self.angular_rate_std_rad_s + GYRO_BIAS_STD_rad_s,) * 3 + (inf,) * 3


class WrenchSensorSettings(SensorRole):
    """A device that measures the external wrench on the platform: force and moment at its origin."""

    node_id: Node = 9
    rate_Hz: Above0 = 1000.0
    """Samples per second, at most one per tick."""


class InclinationSettings(SensorRole):
    """An inclinometer on the platform: roll and pitch, with R = Rz(yaw) Ry(pitch) Rx(roll)."""

    node_id: Node = 10
    calibration: InclinationCalibration = InclinationCalibration()
    rate_Hz: Above0 = 100.0
    """Samples per second."""
    std_deg: Above0 = 0.1
    """Standard deviation of the error of each angle, that of the mounting included."""
    device: AnySensor
    """The device, by the family that reads its frames: its own keys, and `protocol`."""

    @property
    def std(self) -> tuple[float, ...]:
        """Of the vertical about the platform's axes."""
        return (radians(self.std_deg),) * 3 + (inf,) * 3


class LegSensorSettings(SensorRole):
    """A device on each leg: a second encoder, or a load cell."""

    node_ids: Annotated[list[Node], Field(min_length=6, max_length=6)] = [11, 12, 13, 14, 15, 16]
    """Node number of each leg's device, in leg order, for families with node numbers."""
    rate_Hz: Above0 = 500.0
    """Samples per second of each."""
    device: AnySensor
    """The devices, by the family that reads their frames: its own keys, and `protocol`."""

    @field_validator("node_ids")
    @classmethod
    def _each_once(cls, ids: list[int]) -> list[int]:
        refuse_twice("two legs have the same node number", ids)
        return ids


class LengthSensorSettings(LegSensorSettings):
    """A second encoder on each leg."""

    calibration: LengthCalibration = LengthCalibration()
    std_m: Above0 = 1e-4
    """Standard deviation of its error, zero and scale included. Three of these are its limit."""
    on_contradiction: Literal["stop", "warn"] = "stop"
    """Reaction if it contradicts the drive's encoder, and is not itself the wrong one: fault ENCODER, or only
    a warning."""

    @property
    def std(self) -> tuple[float, ...]:
        """Of a leg's length."""
        return (self.std_m, *(inf,) * 5)


class ForceSensorSettings(LegSensorSettings):
    """A load cell on each leg."""

    calibration: ForceCalibration = ForceCalibration()
    std_N: Above0 | None = None
    """Standard deviation of its difference from the force that the drive reports, friction included; without
    one they are not compared."""

    @property
    def std(self) -> tuple[float, ...]:
        """Of a leg's force."""
        return (inf if self.std_N is None else self.std_N, *(inf,) * 5)


class SensorSettings(Section):
    """Sensors next to the drives; an omitted one does not exist."""

    tracker: TrackerSettings | None = None
    imu: ImuSettings | None = None
    wrench: WrenchSensorSettings | None = None
    inclination: InclinationSettings | None = None
    lengths: LengthSensorSettings | None = None
    """Second encoders: a length a leg."""
    forces: ForceSensorSettings | None = None
    """Load cells: a force a leg."""
