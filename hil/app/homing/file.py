"""The file that says where the legs of a robot were parked: read, checked, written whole."""

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
_REMARK = "where the legs of a robot stand; written by `hil run` at its end and by `hil homing`"


class HomingFile(Section):
    """Lengths and motor positions of six legs, leg order."""

    kind: Literal["homing"]
    version: int
    state: Literal["parked", "stated", "moved"]
    """parked: as a run left them at rest; stated: as `hil homing` was told; moved: a run has opened the
    brakes and has not said where it left the legs."""
    date: str
    """UTC."""
    configuration: str
    """Name of the configuration."""
    robot: str
    """Hash of what lengths and turns depend on: sections platform and drives."""
    lengths_m: SixLengths
    turns: SixTurns | None
    """Positions that the motors' drives reported then, turns; null: nobody has read them."""
    stated_legs: list[Annotated[int, Field(ge=0, le=5)]] | None = None
    """Of a file that is stated, the legs that were measured by hand: the others stay as they were parked.
    null: all."""


def robot_hash(c: Configuration) -> str:
    """Return what changes where legs, drives or their transmission do."""
    drives = c.drives.model_dump(
        mode="json", include={"protocol", "node_ids", "options", "transmission", "homing"}
    )
    if drives["homing"] is not None:
        drives["homing"] = drives["homing"]["forgotten_turns"]
    robot = {"platform": c.platform.model_dump(mode="json"), "drives": drives}
    return hashlib.sha256(json.dumps(robot, sort_keys=True).encode()).hexdigest()[:16]


def homing_path(c: Configuration, *, emulated: bool) -> Path | None:
    """Return the file of real or emulated drives, if any. Raises ConfigurationError: they forget nothing."""
    if c.drives.homing is None:
        raise ConfigurationError(
            f"{c.source}: drives.homing: missing: nothing says that these drives forget their turns"
        )
    if not emulated:
        return c.folder / c.drives.homing.file
    name = None if c.plant is None else c.plant.homing_file
    return None if name is None else c.folder / name


def command(c: Configuration, *, emulated: bool) -> str:
    """Return the command that says where the legs stand."""
    return f"hil homing {c.source}{' --emulated' if emulated else ''}"


def _remedy(c: Configuration, path: Path) -> str:
    own = command(c, emulated=path != homing_path(c, emulated=False))
    return f"say where the legs stand with `{own}` --at-home or --lengths"


def read_homing(c: Configuration, path: Path) -> HomingFile:
    """Return the file. Raises ConfigurationError: missing, not whole, of another version or another robot."""
    mend = _remedy(c, path)
    if not path.exists():
        raise ConfigurationError(f"{path}: no such file: nobody knows in which turn each motor is: {mend}")
    try:
        file, _ = read_section(path, HomingFile)
    except ConfigurationError as error:
        raise ConfigurationError(*error.problems, f"{path}: is no whole homing file: {mend}") from None
    if file.version != VERSION:
        raise ConfigurationError(f"{path}: version {file.version}, allowed: {VERSION}: {mend}")
    if file.robot != robot_hash(c):
        raise ConfigurationError(
            f"{path}: written {file.date} for another robot, configuration {file.configuration!r}: sections "
            f"platform and drives of {c.source} are others; name another drives.homing.file, or {mend}"
        )
    return file


def refuse_moved(c: Configuration, path: Path, file: HomingFile) -> HomingFile:
    """Return the file. Raises ConfigurationError if its run has not said where it left the legs."""
    if file.state == "moved":
        raise ConfigurationError(
            f"{path}: the run of {file.date} opened the brakes and did not end at rest with all legs "
            "measured, or it runs still: nobody knows in which turn each motor is: "
            f"{_remedy(c, path)}"
        )
    return file


def write_homing(c: Configuration, path: Path, file: HomingFile) -> None:
    """Write the file, whole or not at all. Raises ConfigurationError if it cannot be written."""
    write_section(path, file, f"{_REMARK} {c.source}")


def homing_file(
    c: Configuration,
    state: Literal["parked", "stated", "moved"],
    lengths_m: list[float],
    turns: list[float] | None,
    stated_legs: list[int] | None = None,
) -> HomingFile:
    """Return a file of this robot and this moment."""
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
