"""From a Configuration to the parts of both ends of the bus."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers import PROTOCOLS
from drivers.bustime import BitTiming, BusBudget
from drivers.dbc import legs_dbc
from drivers.errors import PlantError
from drivers.protocol import DriveProtocol
from drivers.signals import Reaction
from hil.app import consistency
from hil.app.configuration import Configuration, platform_dict
from hil.config import Pose, SampledReference
from hil.control import build_law
from hil.cycle import Cycle, Parts
from hil.geometry import Platform
from hil.kinematics import leg_lengths
from hil.record import Scene
from hil.rotations import rotation_from_vector
from hil.safety import Safety
from hil.signals import Array
from hil.trajectory import build_trajectory
from plant_fmu.config import BenchPlant
from plant_fmu.faults import FaultPlan
from plant_fmu.fmu import open_plant
from plant_fmu.nodes import Nodes
from plant_fmu.plant import Plant

LENGTH_TOLERANCE_M = 1e-3
"""How far the plant's initial lengths may be from those of the section `platform`."""
REFERENCE_CSV = "reference.csv"
"""Attachment of a log: the samples of its reference."""


def pose_arrays(pose: Pose) -> tuple[Array, Array]:
    """Return p (3,) m and R (3, 3) of a configured pose."""
    return (
        np.array(pose.position_m, float),
        rotation_from_vector(np.deg2rad(np.array(pose.rotation_vector_deg, float))),
    )


def build_protocol(configuration: Configuration) -> DriveProtocol:
    """Return the codec that both ends use."""
    return PROTOCOLS[configuration.drives.protocol](configuration.bus, configuration.drives)


def bit_timing(configuration: Configuration) -> BitTiming:
    """Return the bus' bit rates."""
    return BitTiming(configuration.bus.bitrate_bit_s, configuration.bus.data_bitrate_bit_s)


def bus_budget(configuration: Configuration, rate_Hz: float) -> BusBudget | None:
    """Return the bus-time arithmetic of one tick; None for the ideal layout, which takes no time.

    Raises ConfigurationError when the frames do not fit.
    """
    if configuration.bus.layout == "ideal":
        return None
    return consistency.bus_budget(configuration.bus, configuration.drives, rate_Hz)


def feedback_window_s(configuration: Configuration, rate_Hz: float) -> float:
    """Return how long a tick waits for its six feedbacks; by default 65 % of the period."""
    return configuration.loop.window_s(rate_Hz)


def build_cycle(configuration: Configuration, rate_Hz: float, watchdog_s: float) -> Cycle:
    """Return the controller at `rate_Hz`, which sets the drives' watchdogs to `watchdog_s`.

    At another rate than the configured one the force may change by the same amount per second.
    """
    c = configuration
    limits = c.limits.model_copy(update={"force_step_N": c.limits.force_step_N * c.loop.rate_Hz / rate_Hz})
    platform = Platform.from_dict(platform_dict(c.platform))
    p, R = pose_arrays(c.platform.home)
    safety = Safety(
        limits,
        length_min=c.platform.length_min_m,
        length_max=c.platform.length_max_m,
        rate_Hz=rate_Hz,
        drive_force_limit=c.drives.force_limit_N,
        on_recorder_loss=c.recording.on_recorder_loss,
    )
    return Cycle(
        Parts(
            platform=platform,
            leg_spin=c.platform.leg_spin,
            protocol=build_protocol(c),
            law=build_law(c.controller, platform, c.platform.leg_spin),
            trajectory=build_trajectory(c.reference, c.platform.home, c.folder),
            safety=safety,
            engage=c.engage,
            home_p=p,
            home_R=R,
            rate_Hz=rate_Hz,
            watchdog_s=watchdog_s,
            reaction=Reaction[c.drives.reaction.upper()],
        )
    )


def build_nodes(configuration: Configuration, faults: FaultPlan | None = None) -> tuple[Nodes, Plant]:
    """Return the six emulated drives and the configured plant behind them; the caller closes the plant.

    Raises PlantError: the plant cannot be opened, or does not start at the configured platform's lengths.
    """
    c = configuration
    assert c.plant is not None
    home = c.platform.home
    start = Pose(
        position_m=c.plant.initial_position_m or home.position_m,
        rotation_vector_deg=c.plant.initial_rotation_vector_deg or home.rotation_vector_deg,
    )
    p, R = pose_arrays(start)
    plant = open_plant(
        c.plant,
        platform=platform_dict(c.platform) | {"leg_spin": c.platform.leg_spin},
        length_min=np.full(6, c.platform.length_min_m),
        length_max=np.full(6, c.platform.length_max_m),
        p0=p,
        R0=R,
        folder=c.folder or Path(),
    )
    try:
        if not isinstance(c.plant.model, BenchPlant):
            _compare_lengths(c, plant, p, R)
        return Nodes(plant, build_protocol(c), c.plant.drives, c.drives, faults), plant
    except BaseException:
        plant.close()
        raise


def _compare_lengths(c: Configuration, plant: Plant, p: Array, R: Array) -> None:
    """Refuse a plant whose legs start elsewhere than the configured platform's: it is another robot or pose.

    The controller would move it as if it were the configured one. A bench has no platform to compare with.
    """
    given, _ = plant.reset()
    expected = leg_lengths(Platform.from_dict(platform_dict(c.platform)), p, R)
    if np.abs(given - expected).max() > LENGTH_TOLERANCE_M:
        raise PlantError(
            f"{c.source}: the plant starts with other leg lengths than section platform has at the initial "
            f"pose, allowed: {1e3 * LENGTH_TOLERANCE_M:g} mm apart.\n"
            f"  plant:    {_metres(given)}\n"
            f"  platform: {_metres(expected)}\n"
            "Give the plant the same geometry, or set plant.initial_position_m and "
            "plant.initial_rotation_vector_deg to the pose at which it starts"
        )


def _metres(lengths: Array) -> str:
    return " ".join(f"{q:.4f}" for q in lengths) + " m"


def build_scene(configuration: Configuration) -> Scene:
    """Return what live views draw."""
    robot = platform_dict(configuration.platform)
    return Scene(robot["base_joints"], robot["platform_joints"])


def attachments(configuration: Configuration) -> list[tuple[str, bytes]]:
    """Return what a log carries beside its configuration: what replay needs and the text does not hold."""
    files = [("legs.dbc", legs_dbc().encode())]
    if isinstance(configuration.reference, SampledReference):
        files.append((REFERENCE_CSV, configuration.path(configuration.reference.path).read_bytes()))
    return files


def with_attached_reference(configuration: Configuration, path: Path) -> Configuration:
    """Return the configuration with the samples of its reference in the file `path`."""
    assert isinstance(configuration.reference, SampledReference)
    reference = configuration.reference.model_copy(update={"path": str(path.absolute())})
    return configuration.model_copy(update={"reference": reference})
