"""Cache folder of this user, for compiled kernels and built FMUs."""

from __future__ import annotations

import os
from pathlib import Path

from drivers.errors import RunError
from drivers.files import own_folder


def cache_folder() -> Path:
    """Make the cache folder of this user alone, or make sure that the one that is there is one.

    ``hexapod-hil`` under ``$XDG_CACHE_HOME``, where that is an absolute path, else under ``~/.cache``.

    Raises RunError where it cannot be made or others have a right to it: their code would be run.
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    # Path.home raises for a user without a home folder.
    parent = given if Path(given).is_absolute() else os.path.expanduser("~/.cache")  # noqa: PTH111
    folder = Path(parent) / "hexapod-hil"
    try:
        return own_folder(folder)
    except OSError as error:
        raise RunError(
            f"cache folder {folder}: {error.strerror}; or set XDG_CACHE_HOME to a folder of your own"
        ) from error


CACHE_FOLDER = cache_folder()
