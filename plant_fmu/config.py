"""Configuration section `plant`: the other end of a virtual bus."""

from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self, Union

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from drivers.registry import sections
from drivers.section import Section
from plant_fmu.faults import AnyFault

if TYPE_CHECKING:
    from pathlib import Path

    from plant_fmu.plant import Plant, Robot

SLOWEST_Hz = 0.1
"""Of a force loop: below that its lag would be that of no drive, and what remembers it had no end."""


def _of_a_drive(bandwidth_Hz: float) -> float:
    if 0.0 < bandwidth_Hz < SLOWEST_Hz:
        raise ValueError(
            f"slower than any drive, allowed: 0 (no lag), or at least {SLOWEST_Hz:g}, given: {bandwidth_Hz:g}"
        )
    return bandwidth_Hz


Bandwidth = Annotated[float, Field(ge=0), AfterValidator(_of_a_drive)]


class DriveEmulation(Section):
    """What the six emulated drives add in front of the plant."""

    encoder_resolution_m: Annotated[float, Field(ge=0)] = 1e-6
    """Quantum of the length measurement; 0 is exact."""
    damping_N_s_m: Annotated[float, Field(ge=0)] = 20_000.0
    """Gain of the `damp` reaction."""
    hold_stiffness_N_m: Annotated[float, Field(ge=0)] = 2e6
    """Stiffness of the `hold` reaction; its damping is `damping_N_s_m`."""
    force_bandwidth_Hz: Bandwidth = 0.0
    """First-order force lag for plants without one of their own; 0 is none."""
    brake_open_ms: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """From the command to a brake that is free; 0: at once."""
    brake_close_ms: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    """From the command to a brake that holds; until then the drive keeps its last force. 0: at once."""


class PlantModel(Section):
    """Section `plant.model` of one kind of plant, an entry point of the group `hil.plants`."""

    type: str
    opens: ClassVar[str]
    """`module:function` that opens the plant from this section, the robot and the configuration's folder."""

    def open(self, robot: "Robot", folder: "Path") -> "Plant":
        """Open the plant; a kind that has a robot of its own ignores this one. Raises PlantError.

        folder: the configuration's, where a relative path starts.
        """
        plant: Plant = resolve_name(self.opens)(self, robot, folder)
        return plant


class StewartPlant(PlantModel):
    """Our FMU: the platform of section `platform` with drives, friction, brakes and end stops."""

    type: Literal["stewart"]
    opens = "plant_fmu.stewart.plant:stewart_plant"
    fmi_version: Literal["2.0", "3.0"] = "3.0"
    isolation: Literal["in_process", "child_process"] = "in_process"
    force_bandwidth_Hz: Bandwidth = 200.0
    """First-order force loop of the drives; 0 is ideal."""
    viscous_friction_N_s_m: Annotated[float, Field(ge=0)] = 0.0
    coulomb_friction_N: Annotated[float, Field(ge=0)] = 0.0
    reflected_mass_kg: Annotated[float, Field(ge=0)] = 0.0
    """Motor and screw inertia seen along each leg."""
    brake_force_N: Annotated[float, Field(ge=0)] = 20_000.0
    """Largest force of each engaged brake; below the static load the legs slip."""
    internal_step_us: Annotated[float, Field(gt=0)] = 100.0
    """Fixed step of the integrator inside the FMU. Default: the longest whole part of the loop's period up to
    100 us."""


class BenchPlant(PlantModel):
    """Six uncoupled legs, m x'' + b x'|x'| + k0 x + k1 x^3 = f: for commissioning drives."""

    type: Literal["bench"]
    opens = "plant_fmu.bench:Bench"
    mass_kg: Annotated[float, Field(gt=0)] = 200.0
    damping_N_s2_m2: Annotated[float, Field(ge=0)] = 500.0
    stiffness_N_m: Annotated[float, Field(ge=0)] = 5_000.0
    stiffness_N_m3: Annotated[float, Field(ge=0)] = 20_000.0
    rest_length_m: Annotated[float, Field(gt=0)] = 1.6
    internal_step_us: Annotated[float, Field(gt=0)] = 100.0
    """As that of `stewart`."""


class FmuPlant(PlantModel):
    """Any co-simulation FMU, with a map from our six legs to its variables."""

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
    """Six input variable names (or one array of six), 1 engaged; empty if the FMU has no brakes."""
    wrench: list[str] = []
    """Six input variable names (or one array of six), N and N m; empty if none."""
    parameters: dict[str, float | int | bool | str | list[float]] = {}
    """Start values to set before initialisation."""
    assume_unit: dict[str, Literal["N", "N.m", "m", "m/s"]] = {}
    """Units of variables whose description states none: by a variable's name, or by force, length, rate or
    wrench for all of that key. A stated unit is never overruled."""
    allow_execution_tool: bool = False
    """Take an FMU that needs the tool that made it at run time. That tool has to be on this machine; only in
    a child process."""
    memory_GB: Annotated[float, Field(ge=0.25, le=1024)] = 4.0
    """Most private memory that its child process may have, in 10^9 bytes; what is shared does not count, and
    processes that it starts have as much again."""
    step_us: Annotated[float, Field(gt=0)] = 1000.0
    """Communication steps are whole multiples of this. Default: the longest whole part of the loop's period
    up to 1000 us."""

    @model_validator(mode="after")
    def _assumed_of_what_is_mapped(self) -> Self:
        keys = ("force", "length", "rate", "wrench")
        mapped = {name for key in keys for name in getattr(self, key)}
        strange = sorted(name for name in self.assume_unit if name not in mapped and name not in keys)
        if strange:
            raise ValueError(
                f"assume_unit names what is not mapped: {', '.join(strange)}; allowed: {', '.join(keys)}, "
                "or a variable that one of them names"
            )
        return self

    @model_validator(mode="after")
    def _a_tool_has_a_process_of_its_own(self) -> Self:
        if self.allow_execution_tool and self.isolation != "child_process":
            raise ValueError(
                "allow_execution_tool in this process, allowed with it: isolation child_process, as a tool "
                "that fails would take the drives with it"
            )
        return self

    @field_validator("force", "length", "rate", "brake", "wrench")
    @classmethod
    def _six_or_one_array(cls, names: list[str], info: ValidationInfo) -> list[str]:
        optional = info.field_name in {"brake", "wrench"}
        if len(names) not in (1, 6) and not (optional and not names):
            empty = ", or an empty list" if optional else ""
            raise ValueError(
                "wrong number of variables, allowed: six names in leg order, or one name of an array of six"
                f"{empty}, given: {len(names)}"
            )
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"the same variable twice: {', '.join(twice)}")
        return names


class SensorNode(Section):
    """What every emulated sensor has."""

    latency_ms: Annotated[float, Field(ge=0, le=60)] = 0.0
    """From the sample to its frame's entry into the bus."""
    lost_percent: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Share of the samples that never become a frame."""


class TrackerEmulation(SensorNode):
    """The emulated tracker: white noise, constant bias."""

    latency_ms: Annotated[float, Field(ge=0, le=60)] = 5.0
    """From the sample to its frame's entry into the bus."""
    position_noise_m: Annotated[float, Field(ge=0)] = 1e-3
    """Standard deviation of each coordinate."""
    orientation_noise_deg: Annotated[float, Field(ge=0)] = 0.1
    """Standard deviation about each axis."""
    position_bias_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """How far the tracker's frame is from the base frame."""
    rotation_bias_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector of the same."""


class ImuEmulation(SensorNode):
    """The emulated IMU: white noise, constant biases."""

    latency_ms: Annotated[float, Field(ge=0, le=60)] = 0.2
    """From the sample to its frame's entry into the bus."""
    angular_rate_noise_rad_s: Annotated[float, Field(ge=0)] = 2e-3
    specific_force_noise_m_s2: Annotated[float, Field(ge=0)] = 0.05
    angular_rate_bias_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    specific_force_bias_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)


class WrenchEmulation(SensorNode):
    """The emulated wrench sensor: white noise, constant bias."""

    force_noise_N: Annotated[float, Field(ge=0)] = 0.0
    moment_noise_N_m: Annotated[float, Field(ge=0)] = 0.0
    force_bias_N: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment_bias_N_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class SensorEmulation(Section):
    """What the emulated sensors add to the truth. Which of them there are says the section `sensors`."""

    seed: Annotated[int, Field(ge=0)] = 1
    """Of all noise and loss: the same seed, the same run."""
    tracker: TrackerEmulation = TrackerEmulation()
    imu: ImuEmulation = ImuEmulation()
    wrench: WrenchEmulation = WrenchEmulation()


PLANTS = sections("hil.plants", PlantModel, "type")
"""`plant.model.type` of the configuration -> its section."""

if TYPE_CHECKING:
    AnyPlant = PlantModel
else:
    AnyPlant = Annotated[Union[tuple(PLANTS.values())], Field(discriminator="type")]  # noqa: UP007


class PlantSettings(Section):
    """What stands in for drives and platform."""

    model: AnyPlant
    drives: DriveEmulation = DriveEmulation()
    sensors: SensorEmulation = SensorEmulation()
    initial_position_m: tuple[float, float, float] | None = None
    """Platform origin at the start; default is the platform's home."""
    initial_rotation_vector_deg: tuple[float, float, float] | None = None
    faults: list[AnyFault] = []
    """What goes wrong at this end of the bus, and when."""
    homing_file: str | None = None
    """What `drives.homing.file` is to real drives, for these: it rehearses parking, power-off and the next
    start. Without it the controller is told where the plant begins."""
    log: bool = True
    """Write the plant's own log with the true pose."""
