"""Files and folders: written whole or not at all, read only where regular, of this user alone.

Nobody ever sees a part of a file under its name. Opening a FIFO waits for its other end, a device may never
end, and either may stand where a file is named. Who can write to a folder could have code run as its user.
"""

import contextlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from drivers.errors import RunError

MOST_BYTES = 4 << 20
"""Of a configuration, a controller, a design or a CSV file."""


def open_regular(path: Path) -> BufferedReader:
    """Open a file to read. Raises OSError, for a FIFO, a socket, a device or a folder too."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY)
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise OSError(0, "not a regular file (a folder, pipe, socket or device)", str(path))
    os.set_blocking(fd, True)
    return os.fdopen(fd, "rb")


def read_regular(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a file. Raises OSError as `open_regular`, or for more than `most` bytes."""
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(0, f"has more than the {most} bytes that are read of such a file", str(path))
    return data


def real_path(path: Path) -> Path:
    """Return where a path leads, its links followed; of links in a circle one, which leads nowhere."""
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError at a circle


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new file beside `path`; give it that name at the end, or remove it where something failed.

    An earlier file is replaced, and its rights go on. What is there and no file, as a pipe, is yielded
    itself.
    Raises OSError, which names `path`: a full disk names none, and nobody knows the new file's name.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = real_path(path)
    try:
        with tempfile.NamedTemporaryFile(dir=target.parent, suffix=target.suffix, delete=False) as file:
            temporary = Path(file.name)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    try:
        yield temporary
        _set_rights(temporary, target)
        temporary.replace(target)
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def _set_rights(new: Path, target: Path) -> None:
    """Give a new file the rights of the one that it replaces, else those of any new file."""
    if target.exists():
        shutil.copymode(target, new)
        return
    umask = os.umask(0)
    os.umask(umask)
    new.chmod(0o666 & ~umask)


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

    Raises OSError: it is a link or no folder, another user's, or others have a right to it.
    """
    made_folder(path)
    status = path.lstat()
    if not stat.S_ISDIR(status.st_mode):
        raise OSError(0, "is a link or no folder, allowed: a folder of mode 0700", str(path))
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o077):
        raise OSError(
            0,
            f"must be a folder that belongs to user {os.getuid()} with mode 0700; it belongs to "
            f"{status.st_uid}, mode {stat.S_IMODE(status.st_mode):04o}: remove it",
            str(path),
        )
    return path


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
