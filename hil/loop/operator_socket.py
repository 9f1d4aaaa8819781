"""A socket of this user on which the controller hears its operator: datagrams, read between two ticks."""

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Self

from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import RunError

AT_MOST = 8
"""Datagrams read in one tick."""


def socket_path(interface: str, channel: str, word: str) -> Path:
    """Return where the controller on a bus listens for words of a kind."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.{word}.sock"


class OperatorSocket:
    """Where datagrams come in. The controller's role on the bus is held while it is open.

    Mutable state: the socket.
    """

    def __init__(self, path: Path, name: str, longest: int) -> None:
        """Listen. longest: bytes that are read of a datagram. Raises RunError when it cannot be made."""
        self.path, self._longest = path, longest
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self.path.unlink(missing_ok=True)  # left by a controller that was killed: we hold its role now
            self._socket.bind(str(self.path))
            self.path.chmod(0o600)
        except OSError as error:
            self._socket.close()
            raise RunError(f"{name} socket {self.path}: {error.strerror or error}") from error
        self._socket.setblocking(False)

    def _heard(self, at_most: int = AT_MOST) -> Iterator[tuple[bytes, str | bytes | None]]:
        """Yield what has come and its sender, so many at once: nobody can hold up a tick."""
        for _ in range(at_most):
            try:
                yield self._socket.recvfrom(self._longest)
            except BlockingIOError:
                return

    def _reply(self, answer: bytes, sender: str | bytes | None) -> None:
        if sender:  # a sender without an address does not want one
            with contextlib.suppress(OSError):
                self._socket.sendto(answer, sender)

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
