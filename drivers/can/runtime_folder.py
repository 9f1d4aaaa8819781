"""The runtime folder, where this user's processes find each other, and one lock per role on a bus."""

import errno
import hashlib
import os
import socket
import struct
import tempfile
from pathlib import Path
from urllib.parse import quote

from drivers.errors import BusError, RunError
from drivers.files import own_folder

NAME = "hexapod-hil"
_PEER = struct.Struct("=3i")
"""struct ucred: process, user, group."""


def runtime_folder() -> Path:
    """Folder for sockets and shared memory, created if missing, mode 0700.

    It lies under XDG_RUNTIME_DIR. Without one it is a folder of the user's own in /dev/shm (memory, so that
    no page of it reaches a disk), or else in the temporary directory.
    Raises BusError if the folder does not belong to this user alone.
    """
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    if session and Path(session).is_dir():
        folder = Path(session) / NAME
    else:
        memory = Path("/dev/shm")  # noqa: S108 - a folder of our own in it, checked below
        base = memory if os.access(memory, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())
        folder = base / f"{NAME}-{os.getuid()}"
    try:
        return own_folder(folder)
    except OSError as error:
        raise BusError(
            f"runtime folder {folder}: {error.strerror}; correct this, or set XDG_RUNTIME_DIR to a "
            "folder of your own"
        ) from error


def safe_name(text: str) -> str:
    """`text` as a file name: all but letters, digits and _.-~ percent-encoded."""
    return quote(text, safe="")


def address(*words: str) -> bytes:
    """Abstract Unix socket address made of these words, unique on this machine.

    Such a socket leaves no file behind; the kernel drops it with its process.
    """
    name = hashlib.sha256(os.fsencode("\0".join(words))).hexdigest()
    return b"\0hexapod-hil." + name.encode()


def _role(interface: str, channel: str, role: str) -> bytes:
    folder = [str(runtime_folder().resolve())] if interface == "localcan" else []
    return address(interface, channel, role, *folder)


def role_holder(interface: str, channel: str, role: str) -> int | None:
    """Id of the process of this machine that holds a role on a channel; 0: id unknown; None: free.

    role: `controller` or `plant`, held by any user. On localcan each runtime folder has channels of its own.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(_role(interface, channel, role))
        except BlockingIOError:  # its queue of waiting connections is full
            return 0
        except OSError:
            return None
        return int(_PEER.unpack(probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))[0])


class RoleLock:
    """Holds a role (controller or plant) on a channel until `close` or the end of the process.

    Mutable state: a socket, which the kernel drops with the process, however it ends.
    Raises RunError if another process holds the role.
    """

    def __init__(self, interface: str, channel: str, role: str) -> None:
        name, held = _role(interface, channel, role), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            held.bind(name)
            held.listen()
        except OSError as error:
            held.close()
            bus = f"bus {interface}:{channel}"
            if error.errno != errno.EADDRINUSE:
                raise BusError(f"{bus}: cannot take the lock of the {role}: {error.strerror}") from error
            raise RunError(
                f"{bus} already has a {role}, process {role_holder(interface, channel, role) or 'unknown'}; "
                "stop it first, or choose another bus.channel"
            ) from None
        self.close = held.close
