"""Cache folder of this user, for compiled kernels and built FMUs."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from drivers.errors import RunError
from drivers.files import own_folder


def cache_folder() -> Path:
    """Return this user's cache folder, made for the user alone.

    ``hexapod-hil`` under ``$XDG_CACHE_HOME``, where that is an absolute path, else under ``~/.cache``; where
    that cannot be written or is not the user's alone, a folder of this user under the temporary directory.

    Raises RunError where neither can be used: what is compiled would be lost, or another's would be run.
    """
    folder, refused = _cache_folder()
    if folder is None:
        raise RunError(
            f"no folder for what is compiled: {'; '.join(refused)}; set XDG_CACHE_HOME to one of your own"
        )
    return folder


def elsewhere() -> str:
    """Return why the cache lies under the temporary directory; empty where it does not."""
    folder, refused = _cache_folder()
    return f"{refused[0]}: what is compiled goes to {folder}" if refused else ""


def _cache_folder() -> tuple[Path | None, list[str]]:
    """Return the first folder that can be used, None without one, and why those before it cannot."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    # Path.home raises for a user without a home folder.
    parent = given if Path(given).is_absolute() else os.path.expanduser("~/.cache")  # noqa: PTH111
    user = os.getuid() if hasattr(os, "getuid") else 0
    refused = []
    for folder in (Path(parent) / "hexapod-hil", Path(tempfile.gettempdir()) / f"hexapod-hil-{user}"):
        try:
            own_folder(folder)
        except OSError as error:
            refused.append(f"{folder}: {error.strerror}")
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            return folder, refused
        refused.append(f"{folder}: no right to write there")
    return None, refused


CACHE_FOLDER = cache_folder()
