"""Builds controller, drives, sensors and plant from a Configuration."""

from __future__ import annotations

import re
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import drivers
from drivers.arrays import Array
from drivers.clock import MONOTONIC, Clock
from drivers.errors import PlantError
from drivers.family import Family
from drivers.files import read_regular
from drivers.protocol import DriveSetup
from drivers.sensors import SensorProtocol
from drivers.signals import LEGS, Reaction
from hil.app.configuration.bus_budget import bus_names
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.app.configuration.fault_rules import require_bus
from hil.app.configuration.feedforward_file import MOST_BYTES, learned_forces
from hil.app.configuration.law_file import ATTACHMENT
from hil.app.configuration.platform import build_platform, platform_dict, pose_arrays
from hil.app.derive_encoder_limits import believed_mass_kg, encoder_limits, leg_errors, read_noise
from hil.app.homing.last_pose import attached, last_pose_of, start_pose
from hil.app.loop_delay import loop_delay
from hil.app.recorded_files import NAMED_FILES, REFERENCE_PLAN
from hil.app.unknown_payload import unknown_payload
from hil.config.delay import ForceDelay
from hil.config.model import ModelSettings
from hil.config.reference import LiveReference, TimeOptimalReference
from hil.control.law import LawContext
from hil.control.model import build_model
from hil.design.stability.monitor import build_watch
from hil.estimation.external_wrench import SENSOR_PATIENCE, ExternalWrench
from hil.estimation.observer import WrenchObserver
from hil.estimation.predictor import Predictor
from hil.loop.admission import Admission, Steering
from hil.loop.homing import LastPose
from hil.loop.parts import Parts
from hil.robot.dynamics import Model
from hil.robot.force_path import ForcePath
from hil.robot.geometry import Platform
from hil.robot.kinematics import leg_lengths
from hil.safety import Safety
from hil.safety.certificate import Watch
from hil.trajectory.build import build_trajectory
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.override import PEAK
from hil.trajectory.path import Trajectory, axis_limits
from hil.trajectory.time_optimal import plan
from plant_fmu.config import BenchPlant, FmuPlant
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant, Robot

if TYPE_CHECKING:  # imported at run time only by commands that run or record
    from hil.estimation.fusion import FusedEstimator
    from hil.loop.cycle import Cycle
    from hil.record import Recording, Scene
    from plant_fmu.drives.nodes import Nodes

LENGTH_TOLERANCE_M = 1e-3
"""Largest difference between the plant's initial leg lengths and those of section `platform`."""


def build_protocol(configuration: Configuration) -> Family:
    """Codec of the configured drive protocol, for both ends of the bus."""
    return drivers.build_protocol(configuration.bus, configuration.drives)


def drive_setup(configuration: Configuration, rate_Hz: float, watchdog_s: float | None = None) -> DriveSetup:
    """Settings that a loop at `rate_Hz` writes to the drives; `watchdog_s`: default as configured."""
    default_s = configuration.drives.watchdog_ms * 1e-3
    reaction = Reaction[configuration.reactions.silence.upper()]
    return DriveSetup(default_s if watchdog_s is None else watchdog_s, reaction, rate_Hz)


def build_sensors(configuration: Configuration) -> SensorProtocol | None:
    """Codec of the configured sensors, for both ends of the bus; None without sensors."""
    sensors = SensorProtocol(configuration.bus, configuration.sensors, configuration.folder)
    return sensors if sensors.sensors else None


def build_cycle(
    configuration: Configuration,
    rate_Hz: float,
    watchdog_s: float,
    recorded: bytes | None = None,
    trajectory: Trajectory | None = None,
    last_pose: LastPose | None = None,
) -> Cycle:
    """Controller of a configuration at `rate_Hz`, which sets the drives' watchdogs to `watchdog_s`.

    The largest force step is scaled so that the force slope in N/s stays the same at every rate.

    recorded: planned reference from a log. trajectory: path to follow; by default that of section
    `reference`. last_pose: pose at which drives without absolute encoders were parked; by default the plant's
    initial pose.
    """
    from hil.loop.cycle import Cycle

    c = configuration
    platform = build_platform(c.platform)
    p, R = pose_arrays(c.platform.home)
    learned = None
    if trajectory is None:
        trajectory = build_trajectory(c.reference, c.platform.home, c.folder, 1.0 / rate_Hz, recorded)
        learned = learned_forces(c.feedforward, c.reference, c.controller, c.platform, c.folder)
    steering, admission = None, build_admission(c, platform)
    if isinstance(trajectory, LiveTrajectory):
        steering = Steering(trajectory, admission, admission.callee)
    predictor = _predictor(c, platform, 1.0 / rate_Hz)
    context = LawContext(
        platform,
        c.platform.leg_spin,
        1.0 / rate_Hz,
        controller=controller_of(c.controller, c.folder),
    )
    return Cycle(
        Parts(
            platform=platform,
            model=Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=believed_mass_kg(c)),
            protocol=build_protocol(c),
            law=c.controller.build(context),
            trajectory=trajectory,
            safety=_safety(c, platform, (p, R), rate_Hz),
            engage=c.engage,
            reactions=c.reactions,
            home_p=p,
            home_R=R,
            rate_Hz=rate_Hz,
            setup=drive_setup(c, rate_Hz, watchdog_s),
            wrench=_external_wrench(c, platform, 1.0 / rate_Hz),
            operator=c.operator,
            admission=admission,
            steering=steering,
            last_pose=last_pose_of(c, None) if last_pose is None else last_pose,
            sensors=build_sensors(c),
            fusion=_fusion(c, platform, rate_Hz),
            predictor=predictor,
            buses=bus_names(c.bus) if c.bus.channels else (),
            learned=learned,
        )
    )


def _safety(c: Configuration, platform: Platform, home: tuple[Array, Array], rate_Hz: float) -> Safety:
    force_step_N = c.limits.force_step_N * c.loop.rate_Hz / rate_Hz
    return Safety(
        c.limits.model_copy(update={"force_step_N": force_step_N}),
        length_min=c.platform.length_min_m,
        length_max=c.platform.length_max_m,
        rate_Hz=rate_Hz,
        drive_force_limit=c.drives.force_limit_N,
        on_recorder_loss=c.recording.on_recorder_loss,
        watch=_watch(c, platform, home, rate_Hz),
        encoders=encoder_limits(c, rate_Hz),
    )


def _watch(c: Configuration, platform: Platform, home: tuple[Array, Array], rate_Hz: float) -> Watch:
    delay = loop_delay(c)
    ticks = ceil(delay.transport_s * c.loop.rate_Hz - 1e-9)
    payload = unknown_payload(c)
    allowed = payload.allowed_of_the_pose if c.controller.axes == "pose" else payload.allowed
    noise = read_noise(c, rate_Hz)
    seen = {"length_noise_m": noise.length_m, "rate_noise_m_s": noise.rate_m_s}
    monitor = allowed(c.monitor).model_copy(update=seen)
    return build_watch(monitor, c.controller, platform, home, 1.0 / rate_Hz, ticks, delay.lag_s)


def _external_wrench(c: Configuration, platform: Platform, period_s: float) -> ExternalWrench:
    settings, sensor = c.estimation.wrench, c.sensors.wrench
    rate_Hz = None if sensor is None or settings.source != "sensor" else sensor.rate_Hz
    observer = None
    if settings.source == "observer":
        believed = settings.model or c.controller.believed or ModelSettings()
        patience_s, cells = 0.0, c.sensors.forces
        if settings.forces == "sensors" and cells is not None:
            patience_s = SENSOR_PATIENCE / cells.rate_Hz + 1e-3 * getattr(cells.device, "latency_ms", 0.0)
            none = dict.fromkeys(("reflected_mass_kg", "viscous_friction_N_s_m", "coulomb_friction_N"), 0.0)
            believed = believed.model_copy(update=none)
        model = build_model(believed, platform, c.platform.leg_spin)
        path = _force_path(settings, period_s)
        observer = WrenchObserver(model, path, settings.bandwidth_Hz, patience_s)
    return ExternalWrench(observer, rate_Hz, period_s)


def build_admission(c: Configuration, platform: Platform) -> Admission:
    """Checks of set-points of a live reference; with any other reference, checks of jogging."""
    if isinstance(c.reference, LiveReference):
        ddchi = axis_limits(c.reference.limits)[1]
    else:
        operator, rate = c.operator, PEAK / c.engage.stop_s
        ddchi = rate * np.repeat([operator.setup_speed_m_s, np.deg2rad(operator.setup_speed_deg_s)], 3)
    return Admission(
        platform,
        Model(platform, leg_spin=c.platform.leg_spin),
        c.limits,
        length_min=c.platform.length_min_m,
        length_max=c.platform.length_max_m,
        drive_force_limit=c.drives.force_limit_N,
        ddchi=ddchi,
        stop_s=c.engage.stop_s,
    )


def _fusion(c: Configuration, platform: Platform, rate_Hz: float) -> FusedEstimator | None:
    if c.estimation.pose != "fused":
        return None
    from hil.estimation.fusion import FusedEstimator

    settings = c.estimation.fusion
    model = build_model(settings.model, platform, c.platform.leg_spin)
    sensors = c.sensors
    return FusedEstimator(
        platform, model, settings, leg_errors(c), sensors.tracker, sensors.imu, 1.0 / rate_Hz
    )


def _predictor(c: Configuration, platform: Platform, period_s: float) -> Predictor | None:
    """Predictor that compensates the loop's delay; None without section `delay_compensation`."""
    delay, believed = c.controller.lookahead, c.controller.believed
    if delay is None or believed is None:
        return None
    model = build_model(believed, platform, c.platform.leg_spin)
    return Predictor(model, _force_path(delay, period_s), 1e-3 * delay.hold_ms)


def _force_path(delay: ForceDelay, period_s: float) -> ForcePath:
    return ForcePath(period_s, 1e-3 * delay.bus_ms, 1e-3 * delay.drive_lag_ms)


def build_robot(c: Configuration) -> Robot:
    """Platform, strokes and initial pose of the plant."""
    p, R = pose_arrays(start_pose(c))
    low, high = (np.full(LEGS, end) for end in (c.platform.length_min_m, c.platform.length_max_m))
    return Robot(platform_dict(c.platform) | {"leg_spin": c.platform.leg_spin}, low, high, p, R)


def build_nodes(configuration: Configuration, faults: FaultPlan | None = None) -> tuple[Nodes, Plant]:
    """Emulated drives and sensors, and the plant behind them; the caller closes the plant.

    The faults of `plant.faults` come first, then those of `faults`. The random seed is that of `faults`.
    Raises PlantError: the plant cannot be opened, or starts at other leg lengths than the configured
    platform.
    """
    from plant_fmu.drives.nodes import Nodes

    c = configuration
    assert c.plant is not None
    robot = build_robot(c)
    plant = c.plant.model.open(robot, c.folder or Path())
    try:
        if not isinstance(c.plant.model, BenchPlant):
            _compare_lengths(c, plant, robot.p0, robot.R0)
        more, seed = ((), 0) if faults is None else (faults.faults, faults.seed)
        require_bus([*c.plant.faults, *more], c.bus, c.drives)
        plan = FaultPlan([*c.plant.faults, *more], seed, c.platform.gravity_m_s2)
        drives = (plant, build_protocol(c), c.plant.drives, c.drives, plan)
        if c.plant.drives.fmu is not None:
            from plant_fmu.network.drives import FmuNodes

            nodes = FmuNodes(*drives, c.folder or Path(), c.bus)
            return nodes, nodes.plant
        sensors = build_sensors(c)
        if sensors is None:
            return Nodes(*drives), plant
        from plant_fmu.drives.sensor_nodes import SensedNodes

        gravity = c.platform.gravity_m_s2
        return SensedNodes(sensors, c.plant.sensors, gravity, *drives), plant
    except BaseException:
        plant.close()
        raise


def _compare_lengths(c: Configuration, plant: Plant, p: Array, R: Array) -> None:
    """Refuse a plant that starts at other leg lengths than the configured platform: another robot or pose.

    The controller would use the wrong model for it. A plant of bare legs has no platform to compare with.
    """
    given, _ = plant.reset()
    expected = leg_lengths(build_platform(c.platform), p, R)
    if np.abs(given - expected).max() > LENGTH_TOLERANCE_M:
        raise PlantError(
            f"{c.source}: the plant's leg lengths differ from those of section platform at the initial "
            f"pose, allowed: by {1e3 * LENGTH_TOLERANCE_M:g} mm.\n"
            f"  plant:    {' '.join(f'{q:.4f}' for q in given)} m\n"
            f"  platform: {' '.join(f'{q:.4f}' for q in expected)} m\n"
            "Give the plant the same geometry, or set plant.initial_position_m and "
            "plant.initial_rotation_vector_deg to the pose at which it starts"
            f"{_counted_from(c, expected - given)}"
        )


def _counted_from(c: Configuration, beyond: Array) -> str:
    """Advice for an FMU whose leg lengths have another zero; beyond (6,) m: what its lengths lack."""
    if c.plant is None or not isinstance(c.plant.model, FmuPlant):
        return ""
    offset = (beyond + c.plant.model.length_offset_m).round(6).tolist()
    value = offset[0] if np.ptp(beyond) < LENGTH_TOLERANCE_M else offset
    return f". If it counts its lengths from elsewhere (a stroke), write plant.model.length_offset_m: {value}"


def build_scene(configuration: Configuration) -> Scene:
    """Joint geometry of base and platform that live 3D views draw."""
    from hil.record import Scene

    robot = platform_dict(configuration.platform)
    return Scene(robot["base_joints"], robot["platform_joints"])


def record(
    c: Configuration,
    cycle: Cycle,
    path: Path,
    kind: str,
    *,
    live: bool = False,
    lockstep: bool = False,
    clock: Clock = MONOTONIC,
    run: str = "",
) -> Recording:
    """Start the recorder of a controller's log; kind: `run` or `sim`; live: draw a status line.

    A run in real time is visible to `hil watch`; `run` identifies a simulated run.
    """
    from hil.app.watch.state import run_description
    from hil.record import Live, Recording
    from hil.record.mirror import mirror_path
    from hil.record.schema import RUN

    rate_Hz, duration_s = cycle.parts.rate_Hz, cycle.parts.trajectory.duration_s
    database = cycle.parts.protocol.traits.database
    mirror = websocket = None
    if not lockstep:
        about = run_description(c, path, rate_Hz, duration_s)
        mirror = mirror_path(c.bus.interface, c.bus.channel), about
        if (there := c.recording.websocket) is not None:
            websocket = there.host, there.port
    return Recording.start(
        path,
        configuration=c.text,
        attachments=[*attachments(c), *attached(cycle.parts.last_pose)],
        metadata={
            "kind": kind,
            "rate_Hz": rate_Hz,
            "watchdog_s": cycle.parts.setup.watchdog_s,
            "protocol": c.drives.protocol,
            "protocol_version": "" if database is None else version_of(database[1]),
            **({RUN: run} if run else {}),
            **({} if c.law_file is None else c.law_file.described()),
        },
        scene=build_scene(c),
        can_channel=[each.channel for each in c.bus.buses],
        lockstep=lockstep,
        ring_ticks=c.recording.ring_ticks,
        live=Live(live, duration_s, websocket),
        clock=clock,
        mirror=mirror,
    )


def databases(configuration: Configuration) -> list[tuple[str, bytes]]:
    """DBC files (name, bytes) of drive protocol and sensors, stored in a log to decode its frames."""
    sensors = build_sensors(configuration)
    own = build_protocol(configuration).traits.database
    ours = (*(() if own is None else (own,)), *(() if sensors is None else sensors.databases))
    return [(name, text.encode()) for name, text in ours]


def version_of(database: str) -> str:
    """VERSION entry in the text of a DBC file; empty without one."""
    found = re.search(r'^VERSION "([^"]*)"', database, re.MULTILINE)
    return "" if found is None else found[1]


def attachments(c: Configuration) -> list[tuple[str, bytes]]:
    """Files (name, bytes) to attach to a log: all that replay needs in addition to the configuration."""
    files = databases(c)
    for name, section, _, kind, path_of in NAMED_FILES:
        settings = getattr(c, section)
        if isinstance(settings, kind):
            files.append((name, read_regular(path_of(settings, c.folder), MOST_BYTES)))
    if c.law_file is not None:
        files.append((ATTACHMENT, c.law_file.source))
    if isinstance(c.reference, TimeOptimalReference):
        files.append((REFERENCE_PLAN, plan(c.reference)))
    return files
