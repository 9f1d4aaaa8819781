"""The operator's word to let go of a platform that only force holds: a datagram on a socket of this user.

The controller listens while it runs, and what comes counts while it holds the platform.
"""

import contextlib
import socket
from pathlib import Path
from typing import Self

from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import RunError

WORD = b"release"
ANSWER_S = 1.0
"""How long the sender waits for the answer."""
_LONGEST = 64
_RELEASED, _NOTHING_HELD = b"released", b"nothing is held"


def release_path(interface: str, channel: str) -> Path:
    """Return where the controller on a bus listens."""
    return runtime_folder() / f"{safe_name(interface)}.{safe_name(channel)}.release.sock"


class ReleaseSocket:
    """Where the word comes in. The controller's role on the bus is held while it is open.

    Mutable state: the socket, and whether it has been asked before; what came before the platform was held
    does not count.
    """

    def __init__(self, interface: str, channel: str) -> None:
        """Listen. Raises RunError when the socket cannot be made."""
        self.path = release_path(interface, channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self.path.unlink(missing_ok=True)  # left by a controller that was killed: we hold its role now
            self._socket.bind(str(self.path))
            self.path.chmod(0o600)
        except OSError as error:
            self._socket.close()
            raise RunError(f"release socket {self.path}: {error.strerror or error}") from error
        self._socket.setblocking(False)
        self._held = False

    def take(self) -> bool:
        """Tell whether the word has come since the last call; called in every tick of HELD."""
        was_held, self._held = self._held, True
        said = False
        while True:
            try:
                data, sender = self._socket.recvfrom(_LONGEST)
            except BlockingIOError:
                return said
            good = data == WORD and was_held
            said = said or good
            if sender:
                with contextlib.suppress(OSError):
                    self._socket.sendto(_RELEASED if good else _NOTHING_HELD, sender)

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def send_release(interface: str, channel: str) -> None:
    """Let the controller on a bus let go of its platform.

    Raises RunError where none listens, or holds nothing.
    """
    where = f"bus {interface}:{channel}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        try:
            sender.bind("")  # Linux gives it an address of its own, outside the file system
            sender.connect(str(release_path(interface, channel)))
        except OSError:
            raise RunError(f"no controller runs on {where}: there is nothing to release") from None
        sender.settimeout(ANSWER_S)
        try:
            sender.send(WORD)
            answer = sender.recv(_LONGEST)
        except OSError:
            answer = b""
        if answer != _RELEASED:
            raise RunError(
                f"the controller on {where} holds no platform whose brakes failed: nothing was released"
            )
