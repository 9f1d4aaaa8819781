"""Files that strangers may have made: opened only where they are regular, read only up to a size.

Opening a FIFO waits for its other end, a device may never end, and either may stand where a file is named.
"""

import os
import stat
from pathlib import Path
from typing import BinaryIO

MOST_BYTES = 4 << 20
"""Of a configuration, a controller, a design or a CSV file."""


class NotRegularError(OSError):
    """Not a regular file, or one that is too large; `strerror` says which, and what is allowed."""


def open_regular(path: Path) -> BinaryIO:
    """Open a file to read.

    Raises NotRegularError for a FIFO, a socket, a device or a folder, OSError.
    """
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY)
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise NotRegularError(0, "is no regular file (a folder, pipe, socket or device)", str(path))
    os.set_blocking(fd, True)
    return os.fdopen(fd, "rb")


def read_regular(path: Path, most: int = MOST_BYTES) -> bytes:
    """Return the content of a file.

    Raises NotRegularError as `open_regular`, or where it has more than `most` bytes; OSError.
    """
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise NotRegularError(0, f"has more than the {most} bytes that are read of such a file", str(path))
    return data
