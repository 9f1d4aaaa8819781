"""Finds the files that campaign rows read, and checks that the files do not change between rows.

A relative path is searched for next to the configuration, as everywhere, then next to the campaign file. The
data sheet of a drive is first searched for in the folder where the campaign was read, as by `hil check`.
"""

import hashlib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from drivers.errors import ConfigurationError
from drivers.files import open_regular
from hil.app.configuration.controller_file import controller_path
from hil.control.state_space import StateSpaceSettings
from hil.study.campaign.keys import at, path
from hil.study.campaign.settings import ListedAxis

_CONTROLLER = ("controller", "controller_file")
_SHEET, _DBC = ("drives", "options", "eds"), ("drives", "options", "dbc")
_FILES = (("reference", "path"), ("feedforward", "file"), ("plant", "model", "path"))
PLACES = (_CONTROLLER, *_FILES, _SHEET, _DBC)
"""Configuration keys that name a file which a row reads."""
Folders = tuple[Path, Path, Path]
"""Absolute folders to search: of the configuration, of the campaign, and where the campaign was read."""


def _find(name: str, place: tuple[str, ...], folders: Folders) -> Path | None:
    looked = (folders[2], *folders[:2]) if place == _SHEET else folders[:2]
    return next((folder / name for folder in looked if (folder / name).is_file()), None)


def find_beside(value: dict[str, Any], folders: Folders) -> None:
    """Make the file paths in a configuration's data absolute, in place."""
    for place in PLACES:
        name = at(value, place)
        if isinstance(name, str) and (file := _find(name, place, folders)) is not None:
            at(value, place[:-1])[place[-1]] = str(file)


def digests(base: dict[str, Any], axes: Mapping[str, ListedAxis], folders: Folders) -> dict[str, str]:
    """SHA-256, by path, of each file that any row of a campaign may read.

    Raises ConfigurationError: a file cannot be read.
    """
    found: dict[str, str] = {}
    for data in (base, *(part for axis in axes.values() for part in _parts(axis))):
        for place in PLACES:
            if isinstance(name := at(data, place), str):
                file = _find(name, place, folders) or folders[0] / name
                if place == _CONTROLLER and not file.is_file():  # or a shipped one
                    settings = StateSpaceSettings(law="state_space", controller_file=name)
                    file = controller_path(settings, folders[0])
                found[str(file)] = _digest_now(file)
    return found


def refuse_changed(files: Mapping[str, str]) -> None:
    """Raise ConfigurationError if a file has changed since the campaign was read, or cannot be read."""
    for name, digest in files.items():
        if _digest_now(Path(name)) != digest:
            raise ConfigurationError(
                f"{name}: has changed since this campaign was read, but all rows need one version. Restore "
                "the file and repeat the command, or discard the rows with `hil campaign --fresh`"
            )


def _digest_now(file: Path) -> str:
    """SHA-256 of a file; the file is read again only if its inode, size or modification time differs."""
    try:
        found = file.stat()
        return _digest(file, found.st_ino, found.st_size, found.st_mtime_ns)
    except FileNotFoundError:
        return "no file"
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be read: {error.strerror}") from None


@lru_cache(maxsize=1024)
def _digest(file: Path, *_: int) -> str:
    with open_regular(file) as opened:
        return hashlib.file_digest(cast("Any", opened), "sha256").hexdigest()


def _parts(axis: ListedAxis) -> Iterator[Any]:
    """Yield the changes that each value of an axis makes, as configuration data; list indices become keys."""
    yield from (axis.options or {}).values()
    for key in axis.targets:
        for value in axis.entries:
            part = value
            for name in reversed(path(key)):
                part = {name: part}
            yield part
