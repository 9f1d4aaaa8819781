"""Files and folders: written whole or not at all, read only if regular, private to this user.

No reader ever sees part of a file under its name. A file name may lead to a FIFO, whose opening waits for a
writer, or to a device without end. Whoever can write to a folder of code can run code as its user.
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

BINARY = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
"""Flags of every `os.open`: the file is not inherited and, on Windows, not translated."""
_AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
"""Flags with which a FIFO opens without a writer; Windows has none."""
MOST_BYTES = 4 << 20
"""Size limit of a configuration, a controller, a design or a CSV file."""


def open_regular(path: Path) -> BufferedReader:
    """Open a file for reading. Raises OSError, also for a FIFO, a socket, a device or a folder."""
    fd = os.open(path, os.O_RDONLY | BINARY | _AT_ONCE)
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise OSError(0, "not a regular file (a folder, pipe, socket or device)", str(path))
    if _AT_ONCE:
        os.set_blocking(fd, True)
    return os.fdopen(fd, "rb")


def read_regular(path: Path, most: int = MOST_BYTES) -> bytes:
    """Content of a file. Raises OSError as `open_regular`, or for more than `most` bytes."""
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(0, f"has more than {most} bytes, the limit for such a file", str(path))
    return data


def real_path(path: Path) -> Path:
    """Path with its symbolic links followed; in a circle of links, one of them, which cannot be opened."""
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError at a circle


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new file next to `path`; rename it to `path` at the end, or remove it after an error.

    It replaces an earlier file and keeps its permissions. If `path` exists and is no file, such as a pipe,
    the block gets `path` itself. Raises OSError with the name `path`: a full disk gives no name, and users do
    not know the new file's name.
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
    """Give a new file the permissions of the file that it replaces, else those of any new file."""
    if target.exists():
        shutil.copymode(target, new)
        return
    umask = os.umask(0)
    os.umask(umask)
    new.chmod(0o666 & ~umask)


def made_folder(path: Path) -> Path:
    """Create a folder and its missing parents, each with mode 0700 whatever the umask is.

    Raises OSError.
    """
    if not os.path.lexists(path.parent):
        made_folder(path.parent)
    path.mkdir(mode=0o700, exist_ok=True)
    return path


def own_folder(path: Path) -> Path:
    """Create a folder private to this user, or check that an existing one is private.

    Raises OSError if it is a link or no folder, belongs to another user, or others have permissions.
    """
    made_folder(path)
    status = path.lstat()
    if not stat.S_ISDIR(status.st_mode):
        raise OSError(0, "is a link or not a folder, allowed: a folder of mode 0700", str(path))
    if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o077):
        raise OSError(
            0,
            f"must be a folder that belongs to user {os.getuid()} with mode 0700; it belongs to "
            f"{status.st_uid}, mode {stat.S_IMODE(status.st_mode):04o}: remove it",
            str(path),
        )
    return path


def cache_folder() -> Path:
    """Create the cache folder, private to this user, or check that an existing one is private.

    It is ``hexapod-hil`` under ``$XDG_CACHE_HOME`` if that is an absolute path, else under ``~/.cache``.

    Raises RunError if it cannot be created or others have permissions: code that they store there would be
    run.
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
