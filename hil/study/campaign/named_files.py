"""The files that the rows of a campaign name: where each is, and what is in it.

A relative path is looked for beside the configuration, then beside the campaign file, then in the folder
where the campaign was read.
"""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from drivers.errors import ConfigurationError
from drivers.files import open_regular
from hil.app.configuration.controller_file import controller_path
from hil.control.state_space import StateSpaceSettings
from hil.study.campaign.keys import at, path
from hil.study.campaign.settings import ListedAxis

_CONTROLLER = ("controller", "controller_file")
PLACES = (
    ("reference", "path"), _CONTROLLER, ("feedforward", "file"), ("plant", "model", "path"),
    ("drives", "options", "eds"),
)  # fmt: skip
"""Keys of a configuration that name a file which a row reads."""
Folders = tuple[Path, ...]
"""Where files are looked for, absolute, in this order: beside the configuration first."""


def _find(name: str, folders: Folders) -> Path | None:
    return next((folder / name for folder in folders if (folder / name).is_file()), None)


def find_beside(value: dict[str, Any], folders: Folders) -> None:
    """Make the paths of a configuration's data absolute."""
    for place in PLACES:
        name = at(value, place)
        if isinstance(name, str) and (file := _find(name, folders)) is not None:
            at(value, place[:-1])[place[-1]] = str(file)


def digests(base: dict[str, Any], axes: Mapping[str, ListedAxis], folders: Folders) -> dict[str, str]:
    """Return the digest of each file that any row may name, by its path.

    Raises ConfigurationError: a file cannot be read.
    """
    found: dict[str, str] = {}
    for data in (base, *(part for axis in axes.values() for part in _parts(axis))):
        for place in PLACES:
            if isinstance(name := at(data, place), str):
                file = _find(name, folders) or folders[0] / name
                if place == _CONTROLLER and not file.is_file():  # or a shipped one
                    settings = StateSpaceSettings(law="state_space", controller_file=name)
                    file = controller_path(settings, folders[0])
                found[str(file)] = _digest(file)
    return found


def _digest(file: Path) -> str:
    try:
        with open_regular(file) as opened:
            return hashlib.file_digest(cast("Any", opened), "sha256").hexdigest()
    except FileNotFoundError:
        return "no file"
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be read: {error.strerror}") from None


def _parts(axis: ListedAxis) -> Iterator[Any]:
    """Yield what each value of an axis sets, as data of a configuration; not what is in a list there."""
    yield from (axis.options or {}).values()
    for key in axis.targets:
        for value in axis.entries:
            part = value
            for name in reversed(path(key)):
                part = {name: part}
            yield part
