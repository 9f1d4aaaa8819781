"""The operator's word to let go of a platform that only force holds: a datagram on a socket of this user.

The controller listens while it runs, and what comes counts while it holds the platform.
"""

import socket
from pathlib import Path

from drivers.errors import RunError
from hil.loop.operator_socket import AT_MOST, OperatorSocket, socket_path

WORD = b"release"
ANSWER_S = 1.0
"""How long the sender waits for the answer."""
QUEUED = 4096
"""More datagrams than can wait in a socket: what has come before the platform was held goes at once."""
_LONGEST = 64
_RELEASED, _NOTHING_HELD = b"released", b"nothing is held"


def release_path(interface: str, channel: str) -> Path:
    """Return where the controller on a bus listens."""
    return socket_path(interface, channel, "release")


class ReleaseSocket(OperatorSocket):
    """Where the word comes in.

    Mutable state: whether it has been asked before; what came before the platform was held does not count.
    """

    def __init__(self, interface: str, channel: str) -> None:
        """Listen. Raises RunError when the socket cannot be made."""
        super().__init__(release_path(interface, channel), "release", _LONGEST)
        self._held = False

    def take(self) -> bool:
        """Tell whether the word has come since the last call; called in every tick of HELD."""
        was_held, self._held = self._held, True
        said = False
        for data, sender in self._heard(AT_MOST if was_held else QUEUED):
            good = data == WORD and was_held
            said = said or good
            self._reply(_RELEASED if good else _NOTHING_HELD, sender)
        return said


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
