"""From a Configuration to the parts of both ends of the bus."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers import PROTOCOLS
from drivers.bustime import BitTiming, BusBudget, check
from drivers.dbc import legs_dbc
from drivers.protocol import DriveProtocol
from drivers.signals import Reaction
from hil.app.configuration import Configuration, platform_dict
from hil.config import Pose
from hil.control import build_law
from hil.cycle import Cycle, Parts
from hil.geometry import Platform
from hil.record import Scene
from hil.rotations import rotation_from_vector
from hil.safety import Safety
from hil.signals import Array
from hil.trajectory import build_trajectory
from plant_fmu.faults import FaultPlan
from plant_fmu.fmu import open_plant
from plant_fmu.nodes import Nodes
from plant_fmu.plant import Plant


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
    return check(
        build_protocol(configuration).cyclic_frames(),
        bit_timing(configuration),
        rate_Hz,
        configuration.bus.max_load_percent,
    )


def feedback_window_s(configuration: Configuration, rate_Hz: float) -> float:
    """Return how long a tick waits for its six feedbacks; by default 65 % of the period."""
    given = configuration.loop.feedback_window_us
    return 0.65 / rate_Hz if given is None else given * 1e-6


def build_cycle(configuration: Configuration, rate_Hz: float, watchdog_s: float) -> Cycle:
    """Return the controller at `rate_Hz`, which sets the drives' watchdogs to `watchdog_s`."""
    c = configuration
    platform = Platform.from_dict(platform_dict(c.platform))
    p, R = pose_arrays(c.platform.home)
    safety = Safety(
        c.limits,
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
    """Return the six emulated drives and the configured plant behind them; the caller closes the plant."""
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
    return Nodes(plant, build_protocol(c), c.plant.drives, c.drives, faults), plant


def build_scene(configuration: Configuration) -> Scene:
    """Return what live views draw."""
    return Scene(configuration.platform.base_joints_m, configuration.platform.platform_joints_m)


def attachments() -> list[tuple[str, bytes]]:
    """Return what every log carries beside its configuration."""
    return [("legs.dbc", legs_dbc().encode())]
