"""`hil homing`: show where the legs of a robot are believed to stand, and say where they do."""

from collections.abc import Mapping, Sequence
from typing import Any

from drivers.errors import ConfigurationError
from drivers.signals import LEGS
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.homing.file import homing_file, homing_path, read_homing, refuse_moved, write_homing
from hil.robot.kinematics import leg_lengths


def state_homing(
    c: Configuration,
    *,
    emulated: bool = False,
    at_home: bool = False,
    lengths_m: Sequence[float] = (),
    legs_m: Mapping[int, float] | None = None,
) -> dict[str, Any]:
    """Write the lengths that are given to the homing file; without any show it. Return the summary.

    emulated: the file of the emulated drives. at_home: the lengths of platform.home. legs_m: single legs, by
    their number; those that are not named stay as the file has them.
    Raises ConfigurationError: no file or no legs to speak of, a length outside the stroke.
    """
    path = homing_path(c, emulated=emulated)
    if path is None:
        raise ConfigurationError(f"{c.source}: plant.homing_file: missing, and --emulated means that file")
    legs = dict(legs_m or {})
    if at_home:
        given = leg_lengths(build_platform(c.platform), *pose_arrays(c.platform.home)).tolist()
    elif lengths_m:
        given = list(lengths_m)
    elif legs:
        file = read_homing(c, path)
        if len(legs) < LEGS:
            refuse_moved(c, path, file)
        given = list(file.lengths_m)
    else:
        return {"success": True, "kind": "homing", "file": str(path)} | _shown(c, path)
    for leg, length in legs.items():
        given[leg] = length
    low, high = c.platform.length_min_m, c.platform.length_max_m
    wrong = [f"leg {leg}: {q:g} m" for leg, q in enumerate(given) if not low <= q <= high]
    if wrong:
        raise ConfigurationError(
            f"{'; '.join(wrong)}: outside the stroke, allowed: {low:g} to {high:g} m, joint centre to joint "
            "centre"
        )
    write_homing(c, path, homing_file(c, "stated", given, None))
    return {"success": True, "kind": "homing", "file": str(path)} | _shown(c, path)


def _shown(c: Configuration, path: Any) -> dict[str, Any]:
    file = read_homing(c, path)
    turns = "not read" if file.turns is None else ", ".join(f"{n:.4f}" for n in file.turns)
    return {
        "state": file.state,
        "date": file.date,
        "lengths_m": ", ".join(f"{q:.6f}" for q in file.lengths_m),
        "motor_turns": turns,
    }
