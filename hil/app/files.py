"""Atomic writing of files, and checks of output files before a command's work begins."""

import contextlib
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from drivers.errors import LogError
from drivers.files import real_path, whole_file
from hil.app.terminal import one_line


def write_whole(path: Path, text: str) -> None:
    """Write a text file atomically, over an earlier file. Raises OSError.

    Characters that UTF-8 cannot encode, as undecodable bytes of a file name, become question marks.
    """
    with made_whole(path, overwrite=True) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


@contextlib.contextmanager
def made_whole(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary file next to `path`; rename it to `path` at the end, or remove it after an error.

    Raises LogError if `path` was created in the meantime and `overwrite` is False; OSError.
    """
    with whole_file(path) as temporary:
        yield temporary
        if not overwrite and real_path(path).exists():
            raise LogError(f"{path}: exists and is not overwritten; name another file")


class Kind(NamedTuple):
    """Kind of an output file; a command replaces an earlier file only if it is of the command's own kind."""

    name: str
    """Noun for messages: `a PNG picture`."""
    holds: Callable[[Path], bool]
    """True for a file of this kind."""


def beginning(name: str, head: bytes) -> Kind:
    """Kind of output file that is recognised by its first bytes `head`."""
    return Kind(name, lambda path: _begins(path, head))


LOG = beginning("a log", b"\x89MCAP0\r\n")
PICTURE = beginning("a PNG picture", b"\x89PNG\r\n")


def new_file(
    path: Path, *, option: str = "--out", force: bool | None = None, own: Kind | None = None
) -> Path:
    """Check the output file `path` before the work begins, and return it.

    option: the option that sets the path; empty for an argument.
    force: True with --force; None: the command has no --force.
    own: a file of this kind, or an empty file, is replaced without `force`; any other file is kept.

    Raises LogError: the file exists and may not be replaced, or is a log, a folder or a device; or its folder
    is missing or not writable.
    """
    if path.is_dir():
        why = "is a folder; name a file"
    elif path.exists() and not path.is_file():
        why = "is a device or a pipe and is not replaced; name a file"
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
        why = "no permission to write there; name another file"
    else:
        return path
    raise LogError(f"{option} {path}: {why}".strip())


def printable(name: str | os.PathLike[str]) -> str:
    """A file name as one line of text; bytes that are not UTF-8 appear as escapes."""
    return one_line(os.fspath(name))


def _begins(path: Path, head: bytes) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(head)) == head
    except OSError:
        return False
