"""Files that are written whole or not at all."""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from drivers.errors import LogError
from drivers.files import real_path, whole_file
from hil.app.terminal import one_line


def write_whole(path: Path, text: str) -> None:
    """Write a text file, in the place of an earlier one. Raises OSError.

    What UTF-8 cannot hold, as bytes of a file's name that are none, becomes a question mark.
    """
    with made_whole(path, overwrite=True) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


@contextlib.contextmanager
def made_whole(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a new file beside `path`; give it that name at the end, or remove it where something failed.

    Raises LogError where `path` exists meanwhile and `overwrite` is not set, OSError.
    """
    with whole_file(path) as temporary:
        yield temporary
        if not overwrite and real_path(path).exists():
            raise LogError(f"{path}: exists and is not overwritten; name another file")


class Kind(NamedTuple):
    """A kind of output, by which a command knows an earlier file of its own: that one is replaced."""

    name: str
    """What is missed of another file: `a PNG picture`."""
    holds: Callable[[Path], bool]
    """Whether a file is of this kind."""


def beginning(name: str, head: bytes) -> Kind:
    """Make a kind of files that begin with `head`."""
    return Kind(name, lambda path: _begins(path, head))


LOG = beginning("a log", b"\x89MCAP0\r\n")
PICTURE = beginning("a PNG picture", b"\x89PNG\r\n")


def new_file(
    path: Path, *, option: str = "--out", force: bool | None = None, own: Kind | None = None
) -> Path:
    """Return the output file `path`, checked before the work begins.

    option: what the file was named with, empty for an argument. force: whether --force is given; None: the
    command has none. own: a file of this kind, or an empty one, is replaced without `force`, and no other is.

    Raises LogError: it exists and may not be replaced, is a log, a folder or a device, or its folder cannot
    be written.
    """
    if path.is_dir():
        why = "is a folder; name a file"
    elif path.exists() and not path.is_file():
        why = "is a device or a pipe, which no file replaces; name a file"
    elif LOG.holds(path):
        why = "is a log, and no log is ever overwritten; name another file"
    elif own and path.exists() and path.stat().st_size and not own.holds(path):
        why = f"exists, is not {own.name} and is not overwritten; name another file"
    elif not own and not force and os.path.lexists(path):
        why = "exists and is not overwritten; name another file" + ", or add --force" * (force is not None)
    elif not path.parent.is_dir():
        why = f"there is no folder {path.parent}; make it first"
    elif not os.access(real_path(path).parent, os.W_OK | os.X_OK) or (
        path.exists() and not os.access(path, os.W_OK)
    ):
        why = "no right to write there; name another file"
    else:
        return path
    raise LogError(f"{option} {path}: {why}".strip())


def printable(name: str | os.PathLike[str]) -> str:
    """Return a name of a file as one line of text; bytes that are no UTF-8 are shown as numbers."""
    return one_line(os.fspath(name))


def _begins(path: Path, head: bytes) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(head)) == head
    except OSError:
        return False
