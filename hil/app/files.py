"""Files that are written whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from drivers.errors import LogError


def write_whole(path: Path, text: str) -> None:
    """Write a text file, in the place of an earlier one. Raises OSError."""
    with made_whole(path, overwrite=True) as temporary:
        temporary.write_text(text)


@contextlib.contextmanager
def made_whole(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield a new file beside `path`; give it that name at the end, or remove it where something failed.

    Raises LogError where `path` exists meanwhile and `overwrite` is not set, OSError.
    """
    target = path.resolve()
    with tempfile.NamedTemporaryFile(dir=target.parent, suffix=target.suffix, delete=False) as file:
        temporary = Path(file.name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        if not overwrite and target.exists():
            raise LogError(f"{path}: exists and is not overwritten; name another file, or add --force")
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
