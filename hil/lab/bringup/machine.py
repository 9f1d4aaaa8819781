"""Derives the machine data that a bring-up needs from a configuration."""

import contextlib

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, ProtocolError
from drivers.family import Family
from drivers.signals import LEGS, DriveState
from drivers.transmission import forgotten_length
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.config.values import Pose
from hil.lab.bringup.context import Machine
from hil.robot.geometry import Platform
from hil.robot.kinematics import leg_lengths
from plant_fmu.drives import drives_end

TILT_deg = (3.0, 2.0, 4.0)
"""Rotation vector from home to the second known pose: there all leg lengths differ."""
TILT_SHARES = (1.0, 0.5, 0.25)
"""Shares of that tilt; the largest one within reach of all legs is used."""
RAISED_m, RAISED_SHARE = 0.03, 0.2
"""Most by which that pose is above or below home, and share of the stroke: each leg changes its length, which
shows the scale of its reading."""
FASTEST_Hz = 500.0
"""Upper limit of the tick rate, low enough for an adapter and a desktop computer."""
WINDOW = 0.9
"""Share of a period spent waiting for answers; the computation after it needs less than the rest."""
PERIODS = 5.0
"""Least number of periods within a watchdog."""


def bringup_rate(c: Configuration) -> float:
    """Tick rate of a bring-up, Hz: FASTEST_Hz, or more for PERIODS per watchdog, up to the loop's rate."""
    least = PERIODS / (1e-3 * c.drives.watchdog_ms)
    return min(c.loop.rate_Hz, max(FASTEST_Hz, least))


def known_poses(c: Configuration) -> list[tuple[Array, Array]]:
    """Position (3,) m and rotation (3, 3) of home and a tilted pose. Raises ConfigurationError: no reach."""
    return [pose_arrays(pose) for pose in _known(c)]


def _known(c: Configuration) -> list[Pose]:
    home, platform = c.platform.home, build_platform(c.platform)
    low, high = c.platform.length_min_m, c.platform.length_max_m
    at_home = leg_lengths(platform, *pose_arrays(home))
    most = min(RAISED_m, RAISED_SHARE * (high - low))
    x, y, z = home.position_m
    for share in TILT_SHARES:
        turned = np.add(home.rotation_vector_deg, np.multiply(share, TILT_deg)).tolist()
        tilted = [
            Pose(position_m=(x, y, z + up), rotation_vector_deg=(turned[0], turned[1], turned[2]))
            for up in np.linspace(-most, most, 13).round(4).tolist()
        ]
        q = np.array([leg_lengths(platform, *pose_arrays(pose)) for pose in tilted])
        within = (low < q.min(axis=1)) & (q.max(axis=1) < high)
        if within.any():
            least = np.where(within, np.abs(q - at_home).min(axis=1), -1.0)
            return [home, tilted[int(np.argmax(least))]]
    q = q[len(q) // 2]
    leg = int(np.argmax(np.maximum(low - q, q - high)))
    tilt_deg = share * float(np.linalg.norm(TILT_deg))
    raise ConfigurationError(
        f"platform.home: the second pose of a bring-up, tilted by {tilt_deg:.2g} deg, takes leg {leg} to "
        f"{q[leg]:.4f} m; allowed: {low:g} to {high:g} m. Choose a home nearer to mid-stroke"
    )


def _words(pose: Pose) -> str:
    place, turn = (", ".join(f"{x:.6g}" for x in v) for v in (pose.position_m, pose.rotation_vector_deg))
    return f"position {place} m, rotation vector {turn} deg"


def build_machine(c: Configuration, protocol: Family) -> Machine:
    """Machine data of a configuration. Raises ConfigurationError if a known pose is out of reach."""
    platform, gear, homing = build_platform(c.platform), c.drives.transmission, c.drives.homing
    poses = known_poses(c)
    joints = [
        np.linalg.norm(
            (p + platform.platform_joints @ R.T)[None, :, :] - platform.base_joints[:, None, :], axis=2
        )
        for p, R in poses
    ]
    unasked = unasked_identifiers(protocol)
    return Machine(
        node_ids=tuple(c.drives.node_ids),
        protocol=c.drives.protocol,
        rated_N=c.drives.force_limit_N,
        length_min=c.platform.length_min_m,
        length_max=c.platform.length_max_m,
        watchdog_s=1e-3 * c.drives.watchdog_ms,
        brake_open_s=c.engage.brake_release_s,
        brake_shut_s=c.engage.closing_s,
        pose_lengths=np.array([leg_lengths(platform, p, R) for p, R in poses]),
        joint_distances=np.array(joints),
        pose_words=tuple(map(_words, _known(c))),
        known_identifiers=unasked | {frame.id for frame in protocol.traits.cyclic_frames},
        unasked_identifiers=unasked,
        platform_kg=float(platform.platform.mass),
        presses=presses(platform, *poses[0]),
        losses=0.0 if gear is None else 1.0 - float(np.min(gear.efficiency)),
        forgotten_m=None
        if homing is None or gear is None
        else forgotten_length(gear, homing.forgotten_turns),
        heartbeat_s=1e-3 * c.drives.heartbeat_ms,
    )


def presses(platform: Platform, p: Array, R: Array) -> float:
    """Cosine between gravity and the direction from platform to base joints at pose p (3,) m, R (3, 3)."""
    g = platform.gravity
    way = platform.base_joints.mean(axis=0) - p - R @ platform.platform_joints.mean(axis=0)
    sizes = float(np.linalg.norm(g) * np.linalg.norm(way))
    return float(g @ way) / sizes if sizes > 0.0 else 0.0


def unasked_identifiers(protocol: Family) -> frozenset[int]:
    """CAN identifiers of the frames that a protocol's drives send unsolicited, e.g. heartbeats."""
    known: set[int] = set()
    for leg in range(LEGS):
        with contextlib.suppress(ProtocolError):
            known |= {frame.id for frame in drives_end(protocol).announce(leg, DriveState.OFF)}
    return frozenset(known)
