"""Homing file with the parked leg lengths of a robot: read, checked, written atomically."""

import hashlib
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from drivers.errors import ConfigurationError
from drivers.section import Section
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.section_file import read_section, write_section

SixLengths = Annotated[list[Annotated[float, Field(gt=0)]], Field(min_length=6, max_length=6)]
SixTurns = Annotated[list[float], Field(min_length=6, max_length=6)]
VERSION = 1
_REMARK = "leg lengths of a robot at rest; written by `hil run` at its end and by `hil homing`"


class HomingFile(Section):
    """Leg lengths and motor positions of six legs at rest, in leg order."""

    kind: Literal["homing"]
    version: int
    state: Literal["parked", "stated", "moved"]
    """parked: left at rest by a run. stated: set with `hil homing`. moved: a run has opened the brakes and
    not yet stored the final lengths.
    """
    date: str
    """UTC."""
    configuration: str
    """Name of the configuration."""
    robot: str
    """Hash of the settings that determine lengths and turns: sections platform and drives."""
    lengths_m: SixLengths
    turns: SixTurns | None
    """Motor positions that the drives reported then, turns; null: not read."""
    stated_legs: list[Annotated[int, Field(ge=0, le=5)]] | None = None
    """Legs measured by hand in a file that is `stated`; the others are as they were parked. null: all."""


def robot_hash(c: Configuration) -> str:
    """Hash of platform, drives and transmission, as hexadecimal text: it changes with any of them."""
    drives = c.drives.model_dump(
        mode="json", include={"protocol", "node_ids", "options", "transmission", "homing"}
    )
    if drives["homing"] is not None:
        drives["homing"] = drives["homing"]["forgotten_turns"]
    robot = {"platform": c.platform.model_dump(mode="json"), "drives": drives}
    return hashlib.sha256(json.dumps(robot, sort_keys=True).encode()).hexdigest()[:16]


def homing_path(c: Configuration, *, emulated: bool) -> Path | None:
    """Homing file of the real or emulated drives, or None. Raises ConfigurationError: no drives.homing."""
    if c.drives.homing is None:
        raise ConfigurationError(
            f"{c.source}: drives.homing: missing: needed for drives that forget their turns"
        )
    if not emulated:
        return c.folder / c.drives.homing.file
    name = None if c.plant is None else c.plant.homing_file
    return None if name is None else c.folder / name


def command(c: Configuration, *, emulated: bool) -> str:
    """Command line that sets the leg lengths in the homing file."""
    return f"hil homing {c.source}{' --emulated' if emulated else ''}"


def _remedy(c: Configuration, path: Path) -> str:
    own = command(c, emulated=path != homing_path(c, emulated=False))
    return f"set the leg lengths with `{own}` --at-home or --lengths"


def read_homing(c: Configuration, path: Path) -> HomingFile:
    """Read the homing file. Raises ConfigurationError: missing, incomplete, of another version or robot."""
    remedy = _remedy(c, path)
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file: the turn of each motor is unknown: {remedy}")
    try:
        file, _ = read_section(path, HomingFile)
    except ConfigurationError as error:
        raise ConfigurationError(*error.problems, f"{path}: not a complete homing file: {remedy}") from None
    if file.version != VERSION:
        raise ConfigurationError(f"{path}: version {file.version}, allowed: {VERSION}: {remedy}")
    if file.robot != robot_hash(c):
        raise ConfigurationError(
            f"{path}: written {file.date} for another robot, configuration {file.configuration!r}: sections "
            f"platform and drives of {c.source} differ; name another drives.homing.file, or {remedy}"
        )
    return file


def refuse_moved(c: Configuration, path: Path, file: HomingFile) -> HomingFile:
    """Return the file. Raises ConfigurationError if its run has not stored where it left the legs."""
    if file.state == "moved":
        raise ConfigurationError(
            f"{path}: the run of {file.date} opened the brakes and did not end at rest with all legs "
            "measured, or is still running: the turn of each motor is unknown: "
            f"{_remedy(c, path)}"
        )
    return file


def write_homing(c: Configuration, path: Path, file: HomingFile) -> None:
    """Write the homing file atomically. Raises ConfigurationError if it cannot be written."""
    write_section(path, file, f"{_REMARK} {c.source}")


def homing_file(
    c: Configuration,
    state: Literal["parked", "stated", "moved"],
    lengths_m: list[float],
    turns: list[float] | None,
    stated_legs: list[int] | None = None,
) -> HomingFile:
    """Content of a homing file for this robot, with the current date; lengths (6) m, turns (6)."""
    return HomingFile(
        kind="homing",
        version=VERSION,
        state=state,
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        configuration=c.name,
        robot=robot_hash(c),
        lengths_m=lengths_m,
        turns=turns,
        stated_legs=stated_legs,
    )
