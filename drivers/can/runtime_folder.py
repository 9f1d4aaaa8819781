"""Where this user's running programs meet: the runtime folder, and one lock per role on a bus."""

import fcntl
import os
import tempfile
import weakref
from pathlib import Path
from typing import Protocol
from urllib.parse import quote

from drivers.errors import BusError, RunError
from drivers.own_folder import own_folder

NAME = "hexapod-hil"


def runtime_folder() -> Path:
    """Return the folder for sockets, locks and shared memory, made if need be, mode 0700.

    It lies under XDG_RUNTIME_DIR; without one it is a folder of the user's own in /dev/shm (memory, so that
    no page of it is ever written to a disk) or, failing that, in the temporary directory.
    Raises BusError when the folder is not this user's alone.
    """
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    if session and Path(session).is_dir():
        folder = Path(session) / NAME
    else:
        memory = Path("/dev/shm")  # noqa: S108 - a folder of our own in it, checked below
        try:
            base = memory if os.access(memory, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())
        except FileNotFoundError as error:
            raise BusError("no folder can be written to; set XDG_RUNTIME_DIR to one of your own") from error
        folder = base / f"{NAME}-{os.getuid()}"
    try:
        return own_folder(folder)
    except OSError as error:
        raise BusError(
            f"runtime folder {folder}: {error.strerror}; or set XDG_RUNTIME_DIR to a folder of your own"
        ) from error


def safe_name(text: str) -> str:
    """Return `text` as a file name: anything but letters, digits and _.-~ percent-encoded."""
    return quote(text, safe="")


class Forgets(Protocol):
    """Holds descriptors that must not live on in a forked child."""

    def forget(self) -> None:
        """Close this process's copies of them."""


def forget_in_child(holder: Forgets) -> None:
    """Close the holder's descriptors in every forked child, which would keep locks and sockets alive."""
    reference = weakref.ref(holder)

    def forget() -> None:
        alive = reference()
        if alive is not None:
            alive.forget()

    os.register_at_fork(after_in_child=forget)


class RoleLock:
    """Holds a role (controller, plant) on a channel for as long as the process lives or until `close`.

    The kernel drops the lock with the process, however it ends. Mutable state: the open lock file.
    """

    def __init__(self, interface: str, channel: str, role: str) -> None:
        path = runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.{safe_name(role)}.lock"
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            raise BusError(f"lock file {path}: {error.strerror}; remove it or set XDG_RUNTIME_DIR") from error
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            other = os.pread(self._fd, 32, 0).decode("ascii", "replace").strip() or "unknown"
            os.close(self._fd)
            self._fd = -1
            raise RunError(
                f"bus {interface}:{channel} already has a {role}, process {other}; "
                "stop it first, or choose another bus.channel"
            ) from None
        os.ftruncate(self._fd, 0)
        os.pwrite(self._fd, f"{os.getpid()}\n".encode(), 0)
        forget_in_child(self)

    def close(self) -> None:
        """Give the role back; in a forked child, close its copy of the lock."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    forget = close
