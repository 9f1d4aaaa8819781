"""Doorbells: a datagram socket per participant, by which another one says that there is something to see."""

import contextlib
import os
import select
import socket
from pathlib import Path

from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import BusError


class Doorbell:
    """The doorbell of one participant, and the way to those of the others, by their serial numbers.

    Mutable state: the socket, and its file as it was made.
    """

    def __init__(self, channel: str) -> None:
        self._prefix = f"{runtime_folder()}/{safe_name(channel)}."
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._own: tuple[Path, os.stat_result] | None = None
        self.fileno = self._socket.fileno
        self.close = self._socket.close

    def bind(self, serial: int) -> None:
        """Become the doorbell of this participant. Raises BusError where there can be no socket."""
        path = Path(f"{self._prefix}{serial}")
        try:
            path.unlink(missing_ok=True)
            self._socket.bind(str(path))
            path.chmod(0o600)
            self._own = path, path.stat()
        except OSError as error:
            raise BusError(
                f"localcan: cannot open the socket {path}: {error}; "
                "set XDG_RUNTIME_DIR to a folder of your own with a short path"
            ) from error

    def ring(self, serial: int) -> bool:
        """Ring a participant; return whether anybody lives there, as far as can be told."""
        try:
            self._socket.sendto(b"", f"{self._prefix}{serial}")
        except (ConnectionRefusedError, FileNotFoundError):
            return self.astray
        except BlockingIOError:
            pass
        return True

    @property
    def astray(self) -> bool:
        """Whether the own socket's file is gone or another one: what is in the folder now says nothing of us.

        Where the user's last session ends, the folder is removed and later made anew.
        """
        if self._own is None:
            return False
        path, made = self._own
        try:
            return not os.path.samestat(path.stat(), made)
        except OSError:
            return True

    def remove(self, serial: int) -> None:
        """Remove what a participant leaves in the file system."""
        path = Path(f"{self._prefix}{serial}")
        if not self.astray:
            path.unlink(missing_ok=True)
        if self._own is not None and self._own[0] == path:
            self._own = None

    def silence(self) -> None:
        """Take all rings that have come."""
        with contextlib.suppress(BlockingIOError):
            while True:
                self._socket.recv(1)

    def wait(self, seconds: float) -> None:
        """Sleep until it rings, or for so long."""
        select.select([self._socket], [], [], seconds)
