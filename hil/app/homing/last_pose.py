"""Leg lengths at rest before a run: from the homing file, the plant's initial pose, or a log."""

import json

import numpy as np

from drivers.arrays import Array
from drivers.errors import LogError
from drivers.signals import LEGS
from drivers.transmission import Transmission, forgotten_length
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.homing.file import HomingFile, command
from hil.config.values import Pose
from hil.loop.homing import LastPose
from hil.robot.kinematics import leg_lengths
from plant_fmu.config import BenchPlant

HOMING_JSON = "homing.json"
"""Attachment of a log: the leg lengths before the run, as the controller got them."""
_ARRAYS = ("length", "limit_m", "step_m", "m_per_turn")
STATED_SHARE = 0.25
"""Largest error of a length measured by hand, as a share of the length that a drive forgets."""


def start_pose(c: Configuration) -> Pose:
    """Initial pose of the plant; home without a plant."""
    home, plant = c.platform.home, c.plant
    if plant is None:
        return home
    return Pose(
        position_m=plant.initial_position_m or home.position_m,
        rotation_vector_deg=plant.initial_rotation_vector_deg or home.rotation_vector_deg,
    )


def start_lengths(c: Configuration) -> Array:
    """Initial leg lengths (6,) m of the plant."""
    if c.plant is not None and isinstance(c.plant.model, BenchPlant):
        return np.full(6, c.plant.model.rest_length_m)
    return leg_lengths(build_platform(c.platform), *pose_arrays(start_pose(c)))


def home_lengths(c: Configuration) -> Array:
    """Leg lengths (6,) m at `platform.home`."""
    return leg_lengths(build_platform(c.platform), *pose_arrays(c.platform.home))


def last_pose_of(c: Configuration, file: HomingFile | None, *, emulated: bool = True) -> LastPose | None:
    """Leg lengths before a run, from the homing file or the plant; None for absolute encoders."""
    homing, transmission = c.drives.homing, c.drives.transmission
    if homing is None or transmission is None:
        return None
    step_m = forgotten_length(transmission, homing.forgotten_turns)
    by_hand = list(range(LEGS)) if file is None or file.stated_legs is None else file.stated_legs
    if file is not None and file.state == "parked":
        by_hand = []
    limit_m = np.full(LEGS, homing.limit_m)
    limit_m[by_hand] = STATED_SHARE * step_m[by_hand]
    origin = "where the plant begins" if file is None else f"{file.state} {file.date}"
    length = start_lengths(c) if file is None else np.array(file.lengths_m)
    m_per_turn = Transmission(transmission).m_per_turn
    return LastPose(length, limit_m, step_m, m_per_turn, origin, command(c, emulated=emulated))


def attached(pose: LastPose | None) -> list[tuple[str, bytes]]:
    """Attachment of a log with the leg lengths before its run; floats are restored bit by bit."""
    if pose is None:
        return []
    fields = {name: v.tolist() if isinstance(v, np.ndarray) else v for name, v in pose._asdict().items()}
    return [(HOMING_JSON, json.dumps(fields, indent=1).encode())]


def recorded(path: object, text: bytes | None) -> LastPose | None:
    """Leg lengths before a run from the attachment of its log; None for a log without. Raises LogError."""
    if text is None:
        return None
    try:
        fields = json.loads(text)
        length, limit_m, step_m, m_per_turn = arrays = [np.array(fields[name], float) for name in _ARRAYS]
        origin, said = str(fields["origin"]), str(fields["command"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        arrays = []
    finite = all(each.shape == (6,) and np.isfinite(each).all() for each in arrays)
    if not arrays or not finite or not (step_m > 0.0).all() or not m_per_turn.all():
        raise LogError(
            f"{path}: attachment {HOMING_JSON}: invalid, allowed: six finite numbers each for "
            f"{', '.join(_ARRAYS)}"
        )
    return LastPose(length, limit_m, step_m, m_per_turn, origin, said)
