"""Rules between sections of a configuration: what each section alone cannot know.

A rule is a pure function from valid sections to (path, message) pairs; it is asked only when all sections it
needs are valid. Only rules that are handed a folder look at other files.
"""

import contextlib
import re
from collections.abc import Callable, Iterator
from inspect import signature
from pathlib import Path as FilePath

import numpy as np

from drivers.config import BusSettings, DriveSettings, SensorSettings
from drivers.errors import ConfigurationError, HilError
from drivers.sensor_kernels import OLDEST
from drivers.sensors import KINDS
from hil.app.configuration.bus_budget import bus_budget
from hil.app.configuration.compare import CompareSettings
from hil.app.configuration.controller_file import unusable
from hil.app.configuration.drive_rules import data_sheet, homing, own_reaction, reported_stroke
from hil.app.configuration.fault_rules import carried_forces, faulty_buses, platform_loads
from hil.app.configuration.feedforward_file import usable_feedforward
from hil.app.configuration.plant_step import plant_steps
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.configuration.reference_rules import frequencies
from hil.app.configuration.yaml_positions import Path
from hil.config.estimation import EstimationSettings
from hil.config.limits import LimitSettings
from hil.config.loop import LoopSettings
from hil.config.platform import PlatformSettings
from hil.config.reference import LiveReference, ReferenceSettings, SampledReference, Waypoint
from hil.config.running import EngageSettings
from hil.config.values import Pose
from hil.control import ControllerSettings
from hil.design.stability.monitor import certified_law
from hil.robot.geometry import GeometryError
from hil.robot.kinematics import leg_lengths
from hil.trajectory.build import build_trajectory
from plant_fmu.config import BenchPlant, FmuPlant, PlantSettings, StewartPlant

Finding = tuple[Path, str]
Folder = FilePath | None
"""Folder of the configuration file; None: do not look at other files."""
Rule = Callable[..., Iterator[Finding]]


def watchdog(drives: DriveSettings, loop: LoopSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a drive watchdog that does not survive two lost commands."""
    period_ms = 1e3 / loop.rate_Hz
    if drives.watchdog_ms < 3 * period_ms * (1 - 1e-9):
        message = (
            f"shorter than three periods, allowed: at least {3 * period_ms:g} (3 x {period_ms:g} ms at "
            f"loop.rate_Hz {loop.rate_Hz:g}), given: {drives.watchdog_ms:g}"
        )
        yield ("drives", "watchdog_ms"), message


def rated_force(drives: DriveSettings, limits: LimitSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a force limit that the drives cannot give."""
    if limits.force_N > drives.force_limit_N:
        message = (
            f"above the drives' rated force, allowed: at most {drives.force_limit_N:g} "
            f"(drives.force_limit_N), given: {limits.force_N:g}"
        )
        yield ("limits", "force_N"), message


def feedback_window(loop: LoopSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a window that leaves the law no time."""
    period_us, window_us = 1e6 / loop.rate_Hz, loop.feedback_window_us
    if window_us is not None and window_us >= period_us:
        message = f"not shorter than the period, allowed: less than {period_us:g}, given: {window_us:g}"
        yield ("loop", "feedback_window_us"), message


def bit_rates(bus: BusSettings, _: Folder) -> Iterator[Finding]:
    """Refuse bit rates outside ISO 11898-1: arbitration to 1 Mbit/s, data phase not slower than that."""
    for n, each in enumerate(bus.buses):
        where: Path = ("bus", "channels", n) if bus.channels else ("bus",)
        if each.bitrate_bit_s > 1_000_000:
            message = f"too fast for arbitration, allowed: at most 1000000, given: {each.bitrate_bit_s}"
            yield (*where, "bitrate_bit_s"), message
        if each.layout == "fd" and each.data_bitrate_bit_s < each.bitrate_bit_s:
            message = (
                f"slower than arbitration, allowed: at least {each.bitrate_bit_s} (bus.bitrate_bit_s), "
                f"given: {each.data_bitrate_bit_s}"
            )
            yield (*where, "data_bitrate_bit_s"), message


_KEYED = re.compile(r"(?:(bus|drives|sensors)((?:\.\w+)*)(?:\[(\d+)\])?: )?(.*)", re.DOTALL)
"""An error that may begin with the key that it objects to."""


def bus_load(
    bus: BusSettings, drives: DriveSettings, sensors: SensorSettings, loop: LoopSettings, _: Folder
) -> Iterator[Finding]:
    """Refuse what the protocol or the sensors cannot do, and frames that do not fit the period."""
    try:
        bus_budget(bus, drives, sensors, loop.rate_Hz)
    except HilError as error:
        found = _KEYED.fullmatch(str(error))
        assert found is not None
        section, keys, index, message = found.groups()
        where: Path = (section or "bus", *filter(None, (keys or "").split(".")))
        yield (*where, int(index)) if index else where, message


def node_numbers(drives: DriveSettings, sensors: SensorSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a node number that a drive or another sensor has."""
    taken = dict.fromkeys(drives.node_ids, "drives.node_ids")
    for kind in KINDS:
        settings = getattr(sensors, kind)
        if settings is None:
            continue
        if settings.node_id in taken:
            message = (
                f"already the number of another node, allowed: one that {taken[settings.node_id]} does not "
                f"have, given: {settings.node_id}"
            )
            yield ("sensors", kind, "node_id"), message
        taken.setdefault(settings.node_id, f"sensors.{kind}.node_id")


def sensor_rates(sensors: SensorSettings, loop: LoopSettings, _: Folder) -> Iterator[Finding]:
    """Refuse more than one sample a tick, and samples so late that their stamp has come round again."""
    for kind in KINDS:
        settings = getattr(sensors, kind)
        if settings is not None and settings.rate_Hz > loop.rate_Hz * (1 + 1e-9):
            message = (
                f"more than one sample a tick, allowed: at most {loop.rate_Hz:g} (loop.rate_Hz), "
                f"given: {settings.rate_Hz:g}"
            )
            yield ("sensors", kind, "rate_Hz"), message
    oldest_ms = 1e3 * (OLDEST - 1) / loop.rate_Hz
    if sensors.tracker is not None and sensors.tracker.latency_max_ms > oldest_ms:
        message = (
            f"older than a stamp can tell, allowed: at most {oldest_ms:g} ({OLDEST - 1} ticks at "
            f"loop.rate_Hz {loop.rate_Hz:g}), given: {sensors.tracker.latency_max_ms:g}"
        )
        yield ("sensors", "tracker", "latency_max_ms"), message


def fusion_sources(
    estimation: EstimationSettings, sensors: SensorSettings, bus: BusSettings, _: Folder
) -> Iterator[Finding]:
    """Refuse to go on without an encoder where nothing else measures the pose, and fusion without forces."""
    if estimation.fusion.may_lose_legs and (estimation.pose != "fused" or sensors.tracker is None):
        message = (
            "without the pose from outside five legs do not hold the platform's pose, allowed: none, or "
            f"estimation.pose fused with sensors.tracker, given: {estimation.fusion.may_lose_legs}"
        )
        yield ("estimation", "fusion", "may_lose_legs"), message
    if estimation.pose == "fused" and bus.layout == "classic":
        message = (
            "the filter needs the drives' forces, and the feedback of bus.layout classic carries none, "
            "allowed with it: legs, given: fused"
        )
        yield ("estimation", "pose"), message


def measured_wrench(estimation: EstimationSettings, sensors: SensorSettings, _: Folder) -> Iterator[Finding]:
    """Refuse to take the external wrench from a sensor that is not there."""
    if estimation.wrench.source == "sensor" and sensors.wrench is None:
        message = "there is no sensors.wrench, allowed without it: none, observer, given: sensor"
        yield ("estimation", "wrench", "source"), message


def live_preview(
    controller: ControllerSettings, reference: ReferenceSettings, _: Folder
) -> Iterator[Finding]:
    """Refuse to look ahead along a path that is not known yet."""
    if isinstance(reference, LiveReference) and controller.lookahead is not None:
        message = (
            "looks ahead along the reference, and where set-points will send a live one is not known, "
            "allowed with reference.type live: leave it out"
        )
        yield ("controller", "delay_compensation"), message


def emulated_sensors(plant: PlantSettings | None, sensors: SensorSettings, _: Folder) -> Iterator[Finding]:
    """Refuse sensors in front of a plant that does not know its pose."""
    configured = [f"sensors.{kind}" for kind in KINDS if getattr(sensors, kind) is not None]
    if plant is not None and configured and not isinstance(plant.model, StewartPlant):
        message = (
            f"knows no pose that {', '.join(configured)} could measure, allowed with sensors: stewart, "
            f"given: {plant.model.type}"
        )
        yield ("plant", "model", "type"), message


def geometry(platform: PlatformSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a platform that is none."""
    try:
        build_platform(platform)
    except GeometryError as error:
        first = error.where.split(",")[0]
        path = ("platform", *(int(w) if w.isdigit() else KEYS.get(w, w) for w in first.split(".")))
        yield path, str(error).removeprefix(f"{error.where}: ")


KEYS = {
    "base_joints": "base_joints_m",
    "platform_joints": "platform_joints_m",
    "mass": "mass_kg",
    "com": "com_m",
    "inertia": "inertia_kg_m2",
    "inertia_axial": "inertia_axial_kg_m2",
    "inertia_transverse": "inertia_transverse_kg_m2",
    "gravity": "gravity_m_s2",
}
"""Names of `hil.robot.geometry` -> keys of the configuration."""


def stroke(platform: PlatformSettings, limits: LimitSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a stroke of no length, and a home outside it."""
    low, high = platform.length_min_m, platform.length_max_m
    if low >= high:
        message = f"not below length_max_m, allowed: less than {high:g}, given: {low:g}"
        yield ("platform", "length_min_m"), message
    elif 2 * limits.stroke_margin_m >= high - low:
        message = (
            f"leaves no stroke, allowed: less than {(high - low) / 2:g} (half of the stroke), "
            f"given: {limits.stroke_margin_m:g}"
        )
        yield ("limits", "stroke_margin_m"), message
    else:
        yield from _within(platform, limits, platform.home, ("platform", "home"))


def reference_poses(
    reference: ReferenceSettings, platform: PlatformSettings, limits: LimitSettings, _: Folder
) -> Iterator[Finding]:
    """Refuse poses of the reference that the legs cannot reach. What lies between is for `hil check`."""
    if platform.length_max_m - platform.length_min_m <= 2 * limits.stroke_margin_m:
        return
    poses: dict[Path, Pose | Waypoint | None] = {(key,): getattr(reference, key, None) for key in POSE_KEYS}
    poses |= {("points", k): point for k, point in enumerate(getattr(reference, "points", ()))}
    for path, pose in poses.items():
        if pose is not None:
            yield from _within(platform, limits, pose, ("reference", *path))


POSE_KEYS = ("pose", "centre", "start")
"""Keys of section `reference` that hold one pose."""


def reference_path(
    reference: ReferenceSettings, platform: PlatformSettings, folder: Folder
) -> Iterator[Finding]:
    """Refuse what is no path: times that do not increase, a repeat that jumps, a CSV file that is none."""
    if isinstance(reference, SampledReference) and folder is None:
        return
    try:
        build_trajectory(reference, platform.home, folder or FilePath())
    except ConfigurationError as error:
        named = re.fullmatch(r"(reference[\w.\[\]]*): (.*)", str(error), re.DOTALL)
        if named:
            words = re.findall(r"\w+", named[1])
            yield tuple(int(w) if w.isdigit() else w for w in words), named[2]
        else:
            sampled = isinstance(reference, SampledReference)
            yield ("reference", "path") if sampled else ("reference",), str(error)


def endless_reference(
    controller: ControllerSettings, reference: ReferenceSettings, platform: PlatformSettings, folder: Folder
) -> Iterator[Finding]:
    """Refuse a reference without end to a law that needs one."""
    if controller.endless is None or (isinstance(reference, SampledReference) and folder is None):
        return
    with contextlib.suppress(ConfigurationError):  # no path at all: `reference_path` says so
        if build_trajectory(reference, platform.home, folder or FilePath()).duration_s is None:
            key, reason = controller.endless
            yield ("controller", key), reason


def designed_controllers(
    controller: ControllerSettings, compare: CompareSettings, loop: LoopSettings, folder: Folder
) -> Iterator[Finding]:
    """Refuse a controller from a file that the loop cannot run, also among the laws to compare."""
    laws = {("controller",): controller} | {("compare", "laws", k): law for k, law in compare.laws.items()}
    for path, law in laws.items():
        trouble = None if folder is None else unusable(law, loop.rate_Hz, folder)
        if trouble is not None:
            yield (*path, "controller_file"), trouble


def brake_times(plant: PlantSettings | None, engage: EngageSettings, _: Folder) -> Iterator[Finding]:
    """Refuse emulated brakes that take longer than the controller gives them."""
    if plant is None:
        return
    for key, given_s, allowing in (
        ("brake_open_ms", engage.brake_release_s, "engage.brake_release_s"),
        ("brake_close_ms", engage.closing_s, "engage.brake_close_s, by default brake_release_s"),
    ):
        taken: float = getattr(plant.drives, key)
        if taken > 1e3 * given_s * (1 + 1e-9):
            message = (
                f"longer than the controller waits for its brakes, allowed: at most {1e3 * given_s:g} "
                f"({allowing}), given: {taken:g}"
            )
            yield ("plant", "drives", key), message


def standstill(plant: PlantSettings | None, limits: LimitSettings, _: Folder) -> Iterator[Finding]:
    """Refuse a tolerance of standstill that encoders at rest exceed."""
    least = 0.0 if plant is None else 4 * plant.drives.encoder_resolution_m
    if limits.standstill_m < least:
        message = (
            f"too near to the resolution of the encoders, allowed: at least {least:g} (4 x "
            f"plant.drives.encoder_resolution_m), given: {limits.standstill_m:g}"
        )
        yield ("limits", "standstill_m"), message


def plant_lag(plant: PlantSettings | None, _: Folder) -> Iterator[Finding]:
    """Refuse the drives' lag twice: our FMU has one of its own."""
    if plant is not None and isinstance(plant.model, StewartPlant) and plant.drives.force_bandwidth_Hz > 0:
        message = (
            "the lag would act twice, allowed: 0 for plant type stewart (the FMU has its own), "
            f"given: {plant.drives.force_bandwidth_Hz:g}"
        )
        yield ("plant", "drives", "force_bandwidth_Hz"), message


def fmu_file(plant: PlantSettings | None, folder: Folder) -> Iterator[Finding]:
    """Refuse an FMU that is not there."""
    if plant is not None and isinstance(plant.model, FmuPlant) and folder is not None:
        path = folder / plant.model.path
        if not path.is_file():
            yield ("plant", "model", "path"), f"no such file, given: {plant.model.path} (looked for {path})"


def bench_rest(plant: PlantSettings | None, platform: PlatformSettings, _: Folder) -> Iterator[Finding]:
    """Refuse bench legs that rest outside the stroke."""
    if plant is not None and isinstance(plant.model, BenchPlant):
        low, high, rest = platform.length_min_m, platform.length_max_m, plant.model.rest_length_m
        if not low < rest < high:
            message = f"outside the stroke, allowed: between {low:g} and {high:g} (platform), given: {rest:g}"
            yield ("plant", "model", "rest_length_m"), message


def _within(
    platform: PlatformSettings, limits: LimitSettings, pose: Pose | Waypoint, path: Path
) -> Iterator[Finding]:
    """Find the legs whose length at `pose` is outside the soft ends of the stroke."""
    try:
        robot = build_platform(platform)
    except HilError:
        return
    low = platform.length_min_m + limits.stroke_margin_m
    high = platform.length_max_m - limits.stroke_margin_m
    q = leg_lengths(robot, *pose_arrays(pose))
    outside = np.flatnonzero((q < low) | (q > high))
    if outside.size:
        legs = ", ".join(f"leg {i} {q[i]:.4f}" for i in outside)
        message = f"out of reach, allowed leg lengths: {low:g} to {high:g} m (soft ends), given: {legs} m"
        yield path, message


RULES: tuple[Rule, ...] = (
    watchdog, rated_force, feedback_window, bit_rates, bus_load, node_numbers, sensor_rates,
    fusion_sources, measured_wrench, live_preview, geometry, stroke, reference_poses, reference_path,
    endless_reference, designed_controllers, certified_law, plant_steps, emulated_sensors, plant_lag,
    brake_times, standstill, fmu_file, bench_rest, platform_loads, faulty_buses, carried_forces, own_reaction,
    reported_stroke, data_sheet, homing, frequencies, usable_feedforward,
)  # fmt: skip
"""A parameter has the name of its section; the last one is the folder."""


def needs(rule: Rule) -> tuple[str, ...]:
    """Return the sections that a rule looks at, in the order of its arguments."""
    return tuple(signature(rule).parameters)[:-1]
