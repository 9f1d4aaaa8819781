"""Files that are written whole or not at all."""

import os
import tempfile
from pathlib import Path


def write_whole(path: Path, text: str) -> None:
    """Write a text file, in the place of an earlier one. Raises OSError."""
    target = path.resolve()
    with tempfile.NamedTemporaryFile("w", dir=target.parent, suffix=target.suffix, delete=False) as file:
        file.write(text)
    umask = os.umask(0)
    os.umask(umask)
    Path(file.name).chmod(0o666 & ~umask)
    Path(file.name).replace(target)
