"""Files that are written whole or not at all."""

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from drivers.errors import LogError
from drivers.files import real_path, whole_file
from hil.app.terminal import one_line
from hil.record.mcap_file import MAGIC

_HALF = re.compile("[\ud800-\udc7f\udd00-\udfff]")
"""Halves of pairs that stand for no byte of a name."""


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


def new_file(path: Path, *, force: bool | None, option: str = "--out", own: bytes = b"") -> Path:
    """Return the output file `path`, checked before the work begins.

    force: whether --force is given; None: the command has none. option: what the file was named with, empty
    for an argument. A file that begins with `own` is an earlier one of the same command, and is replaced
    without `force`, too.

    Raises LogError: it exists and `force` is not set, is a log, a folder or a device, or its folder cannot be
    written.
    """
    where = f"{option} {path}".strip()
    if path.is_dir():
        raise LogError(f"{where}: is a folder; name a file")
    if path.exists() and not path.is_file():
        raise LogError(f"{where}: is a device or a pipe, which no file replaces; name a file")
    if os.path.lexists(path) and not force and not (own and _begins(path, own)):
        hint = "name another file" if force is None else "name another file, or add --force"
        if own:
            hint = "no earlier file of this command; name another file"
        raise LogError(f"{where}: exists and is not overwritten; {hint}")
    if path.is_file() and _begins(path, MAGIC):
        raise LogError(f"{where}: is a log, and no log is ever overwritten; name another file")
    if not path.parent.is_dir():
        raise LogError(f"{where}: there is no folder {path.parent}; make it first")
    if not may_write(path):
        raise LogError(f"{where}: no right to write there; name another file")
    return path


def may_write(path: Path) -> bool:
    """Tell whether there is a right to write a file: a new one is made in its folder and takes its name."""
    if path.exists() and not os.access(path, os.W_OK):
        return False
    if path.exists() and not path.is_file():  # a pipe or a terminal
        return True
    return os.access(real_path(path).parent, os.W_OK | os.X_OK)


def printable(name: str | os.PathLike[str]) -> str:
    """Return a name of a file, in any locale, as one line of text; bytes that are no UTF-8 become signs."""
    text = _HALF.sub("\ufffd", os.fspath(name))
    return one_line(text.encode("utf-8", "surrogateescape").decode("utf-8", "replace"))


def _begins(path: Path, head: bytes) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(head)) == head
    except OSError:
        return False
