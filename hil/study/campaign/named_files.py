"""The files that the rows of a campaign name: where each is, and that it stays what it was.

A relative path is looked for beside the configuration, as everywhere, then beside the campaign file; the data
sheet of a drive before all that in the folder where the campaign was read, as `hil check` does.
"""

import hashlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from drivers.errors import ConfigurationError
from drivers.files import open_regular
from hil.app.configuration.controller_file import controller_path
from hil.control.state_space import StateSpaceSettings
from hil.study.campaign.keys import keys, path
from hil.study.campaign.settings import ListedAxis, entries

_CONTROLLER = ("controller", "controller_file")
_SHEET = ("drives", "options", "eds")
PLACES = (("reference", "path"), _CONTROLLER, ("feedforward", "file"), ("plant", "model", "path"), _SHEET)
"""Keys of a configuration that name a file which a row reads."""
NO_FILE = "no file"
"""In the place of the digest."""


def find_beside(value: dict[str, Any], folder: Path, campaign_folder: Path, here: Path) -> None:
    """Make paths of a configuration's data absolute where the file is beside the campaign file alone.

    here : folder where the campaign was read. The path of a data sheet is always made absolute: who reads it
    looks in the folder where he is.
    """
    for place in PLACES:
        section = _at(value, place[:-1])
        name = _at(section, place[-1:])
        if isinstance(name, str) and place == _SHEET:
            section[place[-1]] = str(_sheet(name, folder, campaign_folder, here))
        elif isinstance(name, str) and not (folder / name).is_file() and (campaign_folder / name).is_file():
            section[place[-1]] = str(campaign_folder / name)


def digests(
    base: dict[str, Any], axes: Mapping[str, ListedAxis], folder: Path, campaign_folder: Path, here: Path
) -> dict[str, str]:
    """Return the digest of each file that any row may name, by its path.

    Raises ConfigurationError: a file cannot be read.
    """
    found: dict[str, str] = {}
    for data in (base, *(part for axis in axes.values() for part in _parts(axis))):
        for place in PLACES:
            name = _at(data, place)
            if isinstance(name, str):
                file = _file(name, place, folder, campaign_folder, here)
                found[str(file)] = _digest_now(file)
    return found


def refuse_changed(files: Mapping[str, str]) -> None:
    """Raise ConfigurationError where a file is another than when the campaign was read, or cannot be read."""
    for name, digest in files.items():
        if _digest_now(Path(name)) != digest:
            raise ConfigurationError(
                f"{name}: has changed since this campaign was read: the next rows would be of another one, "
                "allowed: the same file for all rows. Restore it and repeat the command, or discard the rows "
                "with `hil campaign --fresh`"
            )


def _digest_now(file: Path) -> str:
    """Return the digest of a file; it is read again where its size, time or place on the disk is another."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return NO_FILE
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be read: {error.strerror}") from None
    return _digest(file, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)


@lru_cache(maxsize=1024)
def _digest(file: Path, *_: int) -> str:
    """Return the digest of a file, of whatever size."""
    found = hashlib.sha256()
    try:
        with open_regular(file) as opened:
            while block := opened.read(1 << 20):
                found.update(block)
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be read: {error.strerror}") from None
    return found.hexdigest()


def _sheet(name: str, folder: Path, campaign_folder: Path, here: Path) -> Path:
    found = [place / name for place in (here, folder, campaign_folder) if (place / name).is_file()]
    return found[0] if found else here / name


def _file(name: str, place: tuple[str, ...], folder: Path, campaign_folder: Path, here: Path) -> Path:
    if place == _SHEET:
        return _sheet(name, folder, campaign_folder, here)
    beside = campaign_folder / name
    if not (folder / name).is_file() and beside.is_file():
        return beside
    if place == _CONTROLLER:  # or a shipped one
        return controller_path(StateSpaceSettings(law="state_space", controller_file=name), folder)
    return folder / name


def _parts(axis: ListedAxis) -> Iterator[Any]:
    """Yield what each value of an axis sets, as data of a configuration; not what is in a list there."""
    if axis.options is not None:
        yield from axis.options.values()
    for key in keys(axis):
        for value in entries(axis):
            part = value
            for name in reversed(path(key)):
                part = {name: part}
            yield part


def _at(data: Any, place: tuple[str, ...]) -> Any:
    """Return what is at a place of plain data; None: nothing."""
    for name in place:
        data = data.get(name) if isinstance(data, dict) else None
    return data
