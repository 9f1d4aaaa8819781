"""Files that are written whole or not at all: nobody ever sees a part of one under its name."""

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path


def real_path(path: Path) -> Path:
    """Return where a path leads, its links followed; of links in a circle one, which leads nowhere."""
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError at a circle


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a new file beside `path`; give it that name at the end, or remove it where something failed.

    An earlier file is replaced; its rights, owner and group go on, as far as may be. What is there and
    no file, as a pipe, is yielded itself.
    Raises OSError, which names `path`: a full disk names none, and nobody knows the new file's name.
    """
    target = real_path(path)
    if target.exists() and not target.is_file():
        yield target
        return
    try:
        with tempfile.NamedTemporaryFile(dir=target.parent, suffix=target.suffix, delete=False) as file:
            temporary = Path(file.name)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    try:
        yield temporary
        _as_before(temporary, target)
        temporary.replace(target)
    except OSError as error:
        if error.filename not in (None, str(temporary)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error
    finally:
        temporary.unlink(missing_ok=True)


def _as_before(new: Path, target: Path) -> None:
    """Give a new file the owner, group and rights of the one that it replaces; else those of any new file."""
    try:
        there = target.stat()
    except FileNotFoundError:
        umask = os.umask(0)
        os.umask(umask)
        new.chmod(0o666 & ~umask)
        return
    mode = stat.S_IMODE(there.st_mode)
    with contextlib.suppress(OSError):
        os.chown(new, there.st_uid, -1)
    try:
        os.chown(new, -1, there.st_gid)
    except OSError:
        mode &= ~stat.S_IRWXG  # what that group may is nothing for another one
    new.chmod(mode)
