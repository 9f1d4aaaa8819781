"""Configuration section `plant`: physics, emulated drives and sensors of a simulated or virtual bus."""

from math import radians
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self, Union

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from drivers.registry import sections
from drivers.section import PerLeg, Section, of_leg
from plant_fmu.faults import AnyFault

if TYPE_CHECKING:
    from pathlib import Path

    from plant_fmu.plant import Plant, Robot

SLOWEST_Hz = 0.1
"""Smallest bandwidth of a force loop: no drive is slower, and a longer lag would need unbounded memory."""


def _possible_bandwidth(bandwidth_Hz: float) -> float:
    if 0.0 < bandwidth_Hz < SLOWEST_Hz:
        raise ValueError(
            f"slower than any drive, allowed: 0 (no lag), or at least {SLOWEST_Hz:g}, given: {bandwidth_Hz:g}"
        )
    return bandwidth_Hz


Bandwidth = Annotated[float, Field(ge=0), AfterValidator(_possible_bandwidth)]


Unit = Literal["N", "N.m", "m", "m/s"]


class DriveFmus(Section):
    """CAN FMUs (FMI-LS-BUS) that are the drives: frames on the bus, and ordinary variables to the plant."""

    path: Annotated[list[str], Field(min_length=1)]
    """One .fmu file with all six drives, or six files in leg order; relative to the configuration file."""
    length: list[str]
    """Input variables, unit m. One file: six names, or one array of six. Six files: one name."""
    rate: list[str] = []
    """Input variables, unit m/s, likewise; empty if the FMUs have none."""
    force: list[str]
    """Output variables, unit N, > 0 extends, likewise."""
    brake: list[str]
    """Output variables, Float64 or Boolean, 1 or true is engaged, likewise. Empty: the drives have no brakes,
    and the plant's brakes stay open."""
    parameters: dict[str, float | int | bool | str | list[float]] = {}
    """Parameters to set. Of six files each takes its element of a list of six."""
    assume_unit: dict[str, Unit] = {}
    """Units of variables that declare none, by name, or by force, length, rate."""
    step_us: Annotated[float, Field(gt=0)] = 250.0
    """Longest communication step, rounded to whole steps of the plant. Frames and countdowns are met at
    their own times."""

    @model_validator(mode="after")
    def _one_or_six(self) -> Self:
        if len(self.path) not in (1, 6):
            raise ValueError(f"path: allowed: one file or six, given: {len(self.path)}")
        allowed = (1, 6) if len(self.path) == 1 else (1,)
        for key in ("length", "rate", "force", "brake"):
            names = getattr(self, key)
            if len(names) not in allowed and (names or key in {"length", "force"}):
                raise ValueError(
                    f"{key}: allowed with {len(self.path)} file(s): {' or '.join(map(str, allowed))} names, "
                    f"given: {len(names)}"
                )
        return self


class DriveEmulation(Section):
    """Settings of the six emulated drives: encoder steps, force lag, brake times, heartbeat."""

    fmu: DriveFmus | None = None
    """CAN FMUs in place of the emulated drives. The other keys are then figures of these drives, for
    `hil check`: they change nothing in the simulation."""

    encoder_resolution_m: Annotated[float, Field(ge=0)] = 1e-6
    """Step of the measured leg length; 0: exact."""
    damping_N_s_m: Annotated[float, Field(ge=0)] = 20_000.0
    """Damping of a leg by a drive that reacts by `damp` to a fault."""
    hold_stiffness_N_m: Annotated[float, Field(ge=0)] = 2e6
    """Stiffness of a leg whose drive reacts by `hold`; its damping is `damping_N_s_m`."""
    force_bandwidth_Hz: Bandwidth = 0.0
    """Bandwidth of the first-order force lag, for plants that have no force lag themselves; 0: no lag."""
    brake_open_ms: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """Time from the command until the brake has opened; 0: at once."""
    brake_close_ms: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """Time from the command until the brake has closed; until then the drive keeps its last force. 0: at
    once."""


class PlantModel(Section):
    """Section `plant.model` of one kind of plant, registered in the entry-point group `hil.plants`."""

    type: str
    opens: ClassVar[str]
    """`module:function` that opens the plant from this section, the robot and the configuration file's
    folder."""

    def open(self, robot: "Robot", folder: "Path") -> "Plant":
        """Open the plant of this section. Raises PlantError if that fails.

        robot: platform, legs and initial pose, ignored by a kind with its own; folder: that of the
        configuration file, at which relative paths start.
        """
        plant: Plant = resolve_name(self.opens)(self, robot, folder)
        return plant


class StewartPlant(PlantModel):
    """The built-in FMU: the platform of section `platform` with drives, friction, brakes and end stops."""

    type: Literal["stewart"]
    opens = "plant_fmu.stewart.plant:stewart_plant"
    fmi_version: Literal["2.0", "3.0"] = "3.0"
    isolation: Literal["in_process", "child_process"] = "in_process"
    force_bandwidth_Hz: Bandwidth = 200.0
    """Bandwidth of the drives' first-order force loop; 0: no lag."""
    viscous_friction_N_s_m: Annotated[float, Field(ge=0)] = 0.0
    coulomb_friction_N: Annotated[float, Field(ge=0)] = 0.0
    reflected_mass_kg: Annotated[float, Field(ge=0)] = 0.0
    """Inertia of motor and screw, as a mass along each leg."""
    brake_force_N: Annotated[float, Field(ge=0)] = 20_000.0
    """Largest force of each engaged brake; if it is below the static load, the legs slip."""
    internal_step_us: Annotated[float, Field(gt=0)] = 100.0
    """Fixed step of the integrator inside the FMU. Default: the longest step up to 100 us that divides the
    period of the control loop."""


class BenchPlant(PlantModel):
    """Six uncoupled legs, m x'' + b x'|x'| + k0 x + k1 x^3 = f: to commission drives without a platform."""

    type: Literal["bench"]
    opens = "plant_fmu.bench:Bench"
    mass_kg: Annotated[float, Field(gt=0)] = 200.0
    damping_N_s2_m2: Annotated[float, Field(ge=0)] = 500.0
    stiffness_N_m: Annotated[float, Field(ge=0)] = 5_000.0
    stiffness_N_m3: Annotated[float, Field(ge=0)] = 20_000.0
    rest_length_m: Annotated[float, Field(gt=0)] = 1.6
    internal_step_us: Annotated[float, Field(gt=0)] = 100.0
    """Fixed step of the integrator. Default: the longest step up to 100 us that divides the period of the
    control loop."""


class FmuPlant(PlantModel):
    """Any co-simulation FMU, with a map from the six legs to its variables."""

    type: Literal["fmu"]
    opens = "plant_fmu.fmu.child:fmu_plant"
    path: str
    """The .fmu file, relative to the configuration file."""
    isolation: Literal["in_process", "child_process"] = "child_process"
    force: list[str]
    """Six input variable names (or one array variable of six), unit N."""
    length: list[str]
    """Six output variable names (or one array of six), unit m."""
    rate: list[str]
    """Six output variable names (or one array of six), unit m/s."""
    brake: list[str] = []
    """Six input variable names (or one array of six), 1 or true is engaged; empty if the FMU has no brakes.
    Real, Boolean or integer."""
    wrench: list[str] = []
    """Six input variable names (or one array of six), N and N m; empty if the FMU has no such input."""
    length_offset_m: PerLeg = 0.0
    """Leg length, joint centre to joint centre, where the FMU gives length 0; one for all legs, or six in
    leg order. Not 0 for an FMU that counts from elsewhere, such as the stroke of a prismatic joint."""
    parameters: dict[str, float | int | bool | str | list[float]] = {}
    """Start values of FMU parameters, set before initialisation."""
    assume_unit: dict[str, Unit] = {}
    """Units of variables whose description declares no unit. Keys: the name of a variable, or force, length,
    rate or wrench for all variables of that key. A declared unit is never overruled."""
    allow_execution_tool: bool = False
    """Accept an FMU that needs its authoring tool at run time. The tool must be installed on this machine;
    allowed only in a child process."""
    memory_GB: Annotated[float, Field(ge=0.25, le=1024)] = 4.0
    """Limit of the child process's private memory, in 10^9 bytes. Shared memory does not count; each process
    that it starts has the same limit."""
    step_us: Annotated[float, Field(gt=0)] = 1000.0
    """Communication steps are whole multiples of this. Default: the longest step up to 1000 us that divides
    the period of the control loop."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        keys = ("force", "length", "rate", "wrench")
        mapped = {name for key in keys for name in getattr(self, key)}
        strange = sorted(name for name in self.assume_unit if name not in mapped and name not in keys)
        if strange:
            raise ValueError(
                f"assume_unit: not mapped: {', '.join(strange)}; allowed: {', '.join(keys)}, "
                "or a variable that one of these keys maps"
            )
        if self.allow_execution_tool and self.isolation != "child_process":
            raise ValueError(
                "allow_execution_tool needs isolation child_process: in this process, a tool that fails "
                "would end the drives, too"
            )
        return self

    @field_validator("force", "length", "rate", "brake", "wrench")
    @classmethod
    def _six_or_one_array(cls, names: list[str], info: ValidationInfo) -> list[str]:
        optional = info.field_name in {"brake", "wrench"}
        if len(names) not in (1, 6) and not (optional and not names):
            raise ValueError(
                "wrong number of variables, allowed: six names in leg order, or one name of an array of six; "
                f"none for brake and wrench, given: {len(names)}"
            )
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"the same variable twice: {', '.join(twice)}")
        return names


Three = tuple[float, float, float]
_NONE: Three = (0.0, 0.0, 0.0)


class SensorNode(Section):
    """Settings that the sections of all emulated sensors have."""

    latency_ms: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Time from the sample until its frame enters the bus."""
    jitter_ms: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Further latency, drawn for each sample between 0 and this."""
    time_offset_ms: float = 0.0
    """Error of the time stamp, for devices that have one; > 0: the stamp is later than the sample."""
    lost_percent: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Percentage of the samples that are lost before they become a frame."""
    outlier_percent: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Percentage of the samples that are outliers."""
    outlier_stds: Annotated[float, Field(ge=1)] = 100.0
    """Noise of an outlier, in standard deviations of the others."""
    frame_rotation_deg: Three = _NONE
    """Rotation vector from the sensor's frame to the platform's, imu and wrench; from the base frame to the
    tracker's, about its origin."""
    lever_arm_m: Three = _NONE
    """Place of the sensor, or of the tracker's target, in the platform's frame; tracker, imu and wrench."""

    one: ClassVar[tuple[float, ...]] = (1.0,)
    """Factors to SI of the quantities that share one key; two keys have three quantities each."""

    def errors(self, leg: int) -> tuple[list[float], ...]:
        """Standard deviation of the noise, bias, and drift per second, of each of six quantities."""
        found = []
        for kind in ("noise", "bias", "drift"):
            own = [getattr(self, name) for name in type(self).model_fields if kind in name]
            if len(own) == 1:
                found.append([each * of_leg(own[0], leg) for each in self.one] + [0.0] * (6 - len(self.one)))
            else:
                found.append([x for each in own for x in (each if isinstance(each, tuple) else [each] * 3)])
        return tuple(found)


class TrackerEmulation(SensorNode):
    """Errors of the emulated pose tracker: white noise, constant bias and drift."""

    latency_ms: Annotated[float, Field(ge=0, le=60)] = 5.0
    """Time from the sample until its frame enters the bus."""
    position_noise_m: Annotated[float, Field(ge=0)] = 1e-3
    """Standard deviation of each coordinate of the position."""
    orientation_noise_deg: Annotated[float, Field(ge=0)] = 0.1
    """Standard deviation of the orientation about each axis."""
    position_bias_m: Three = _NONE
    """Offset of the tracker's frame from the base frame."""
    rotation_bias_deg: Three = _NONE
    """Constant error of the orientation alone, a rotation vector in the tracker's frame."""
    target_rotation_deg: Three = _NONE
    """Rotation vector from the target's frame to the platform's."""
    position_drift_m_s: Three = _NONE
    rotation_drift_deg_s: Three = _NONE


class ImuEmulation(SensorNode):
    """Errors of the emulated IMU: white noise, constant biases and drift."""

    latency_ms: Annotated[float, Field(ge=0, le=60)] = 0.2
    """Time from the sample until its frame enters the bus."""
    angular_rate_noise_rad_s: Annotated[float, Field(ge=0)] = 2e-3
    specific_force_noise_m_s2: Annotated[float, Field(ge=0)] = 0.05
    angular_rate_bias_rad_s: Three = _NONE
    specific_force_bias_m_s2: Three = _NONE
    angular_rate_drift_rad_s2: Three = _NONE
    specific_force_drift_m_s3: Three = _NONE


class WrenchEmulation(SensorNode):
    """Errors of the emulated wrench sensor: white noise, constant bias and drift."""

    force_noise_N: Annotated[float, Field(ge=0)] = 0.0
    moment_noise_N_m: Annotated[float, Field(ge=0)] = 0.0
    force_bias_N: Three = _NONE
    moment_bias_N_m: Three = _NONE
    force_drift_N_s: Three = _NONE
    moment_drift_N_m_s: Three = _NONE


class InclinationEmulation(SensorNode):
    """The emulated inclinometer: white noise, bias and drift of both angles."""

    one = (radians(1.0),) * 2
    noise_deg: Annotated[float, Field(ge=0)] = 0.01
    bias_deg: float = 0.0
    drift_deg_s: float = 0.0


class LengthEmulation(SensorNode):
    """The emulated second encoder of each leg."""

    noise_m: Annotated[float, Field(ge=0)] = 1e-6
    bias_m: PerLeg = 0.0
    """One for all legs, or six in leg order."""
    drift_m_s: PerLeg = 0.0
    """One for all legs, or six in leg order."""


class ForceEmulation(SensorNode):
    """The emulated load cell of each leg."""

    noise_N: Annotated[float, Field(ge=0)] = 1.0
    bias_N: PerLeg = 0.0
    """One for all legs, or six in leg order."""
    drift_N_s: PerLeg = 0.0
    """One for all legs, or six in leg order."""


class SensorEmulation(Section):
    """Errors that the emulated sensors add to the true values. Section `sensors` selects the sensors."""

    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of all noise and loss: the same seed gives the same run."""
    tracker: TrackerEmulation = TrackerEmulation()
    imu: ImuEmulation = ImuEmulation()
    wrench: WrenchEmulation = WrenchEmulation()
    inclination: InclinationEmulation = InclinationEmulation()
    lengths: LengthEmulation = LengthEmulation()
    forces: ForceEmulation = ForceEmulation()


PLANTS = sections("hil.plants", PlantModel, "type")
"""`plant.model.type` of the configuration -> its section."""

if TYPE_CHECKING:
    AnyPlant = PlantModel
else:
    AnyPlant = Annotated[Union[tuple(PLANTS.values())], Field(discriminator="type")]  # noqa: UP007


class PlantSettings(Section):
    """Section `plant`: model of the physics, emulated drives and sensors."""

    model: AnyPlant
    drives: DriveEmulation = DriveEmulation()
    sensors: SensorEmulation = SensorEmulation()
    initial_position_m: tuple[float, float, float] | None = None
    """Platform origin at the start, base frame; default: the platform's home."""
    initial_rotation_vector_deg: tuple[float, float, float] | None = None
    faults: list[AnyFault] = []
    """Faults of plant, drives, sensors and frames, with their times."""
    homing_file: str | None = None
    """Homing file of the simulated drives, as `drives.homing.file` is that of real ones: it rehearses
    parking, power-off and the next start. Without it the controller receives the plant's initial lengths."""
    log: bool = True
    """Write the plant's own log with the true pose."""
