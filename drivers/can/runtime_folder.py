"""Where this user's running programs meet: the runtime folder, and one lock per role on a bus."""

import errno
import fcntl
import hashlib
import os
import socket
import tempfile
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import quote

from drivers.errors import BusError, RunError
from drivers.files import own_folder

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


def address(*words: str) -> bytes:
    """Return the abstract socket address that this machine has once for what these words name.

    Such a socket leaves no file behind, and the kernel drops it with its process.
    """
    name = hashlib.sha256(os.fsencode("\0".join(words))).hexdigest()
    return b"\0hexapod-hil." + name.encode()


def role_is_held(interface: str, channel: str, role: str) -> bool:
    """Tell whether a process of this machine, of any user, has a role on a channel.

    Not on one of localcan, which lies in the runtime folder: another folder has another one.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(address(interface, channel, role))
        except OSError:
            return False
    return True


class RoleLock:
    """Holds a role (controller, plant) on a channel for as long as the process lives or until `close`.

    A lock file in the runtime folder names the process. Other users, and who has another XDG_RUNTIME_DIR, do
    not see it; so a role on any interface but localcan is an abstract socket, too. The kernel drops both with
    the process, however it ends. Mutable state: the open lock file and the socket, which `close` gives back.
    """

    def __init__(self, interface: str, channel: str, role: str) -> None:
        bus = f"bus {interface}:{channel}"
        path = runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.{safe_name(role)}.lock"
        with ExitStack() as held:
            try:
                fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
            except OSError as error:
                raise BusError(
                    f"lock file {path}: {error.strerror}; remove it or set XDG_RUNTIME_DIR"
                ) from error
            held.callback(os.close, fd)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                other = os.pread(fd, 32, 0).decode("ascii", "replace").strip() or "unknown"
                raise RunError(
                    f"{bus} already has a {role}, process {other}; "
                    "stop it first, or choose another bus.channel"
                ) from None
            mark = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            try:
                if interface != "localcan":
                    mark.bind(address(interface, channel, role))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise BusError(f"{bus}: no lock of the {role}: {error.strerror}") from error
                raise RunError(
                    f"{bus} already has a {role}, which runs as another user or with another XDG_RUNTIME_DIR "
                    "(sudo, a service, a session that has ended); stop it first, or choose another "
                    "bus.channel"
                ) from None
            os.ftruncate(fd, 0)
            os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
            self.close = held.pop_all().close
