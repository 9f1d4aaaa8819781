"""Folders of this user alone: whoever else can write there could have his code run as this user."""

import os
import stat
from pathlib import Path


class NotOwnError(OSError):
    """A folder that others can reach; `strerror` says why, and how to mend it."""


def made_folder(path: Path) -> Path:
    """Make a folder and those above it that are missing, each with mode 0700 whatever the umask is.

    Raises OSError.
    """
    if not os.path.lexists(path.parent):
        made_folder(path.parent)
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def own_folder(path: Path) -> Path:
    """Make a folder of this user alone, or make sure that the one that is there is one.

    Raises NotOwnError: it is a link or no folder, another user's, or others have a right to it; OSError.
    """
    made_folder(path)
    status = path.lstat()
    if not stat.S_ISDIR(status.st_mode):
        raise NotOwnError(0, "is a link or no folder, allowed: a folder of mode 0700", str(path))
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o077):
        raise NotOwnError(
            0,
            f"must be a folder that belongs to user {os.getuid()} with mode 0700; it belongs to "
            f"{status.st_uid}, mode {stat.S_IMODE(status.st_mode):04o}: remove it",
            str(path),
        )
    return path
