"""Names of files that a process has chosen and not made yet: no other one of this machine chooses them."""

import errno
import os
import socket
from pathlib import Path

from drivers.can.runtime_folder import address
from drivers.files import real_path

_held: dict[Path, int] = {}
"""What this process has reserved, and by which open socket; the kernel closes it with the process."""


def reserved(path: Path) -> bool:
    """Reserve a name; return whether nobody had. Where the system has no such names everything is free."""
    for made in [each for each in _held if os.path.lexists(each)]:
        os.close(_held.pop(made))
    place = real_path(path.parent) / path.name
    if place in _held:
        return False
    try:
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    except OSError:
        return True
    try:
        mark.bind(address(str(place)))
    except OSError as error:
        mark.close()
        return error.errno != errno.EADDRINUSE
    _held[place] = mark.detach()
    return True
