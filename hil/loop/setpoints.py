"""The operator channel of set-points: datagrams on a socket of this user, read between two ticks.

A set-point is a line of six numbers, x y z in m and the rotation vector in deg; the answer is `taken` or why
not.
"""

import math
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Self

from drivers.errors import RunError
from hil.loop import operator_socket
from hil.loop.operator_socket import OperatorSocket
from hil.signals import SetPoint, explain

LONGEST = 512
"""Bytes of a set-point."""
ANSWER_LONGEST = 4096
"""Bytes of an answer, which may quote one."""
ANSWER_S = 1.0
"""How long a sender waits for the answer."""
TAKEN = "taken"
FORM = "six numbers, x y z in m and the rotation vector rx ry rz in deg"


def socket_path(interface: str, channel: str) -> Path:
    """Return where the controller on a bus listens."""
    return operator_socket.socket_path(interface, channel, "setpoint")


def parse(text: str) -> SetPoint:
    """Return the set-point of a line `x y z [rx ry rz]`, m and deg. Raises ValueError with what is wrong."""
    if len(text) > LONGEST:  # what has been cut off could change what it means
        raise ValueError(f"longer than {LONGEST} bytes; allowed: {FORM}")
    words = text.replace(",", " ").split()
    if len(words) not in {3, 6}:
        raise ValueError(f"{len(words)} words; allowed: {FORM} (or x y z alone)")
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        raise ValueError(f"{text.strip()!r} is not {FORM}") from None
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"{text.strip()!r} has a number that is not finite")
    x, y, z, rx, ry, rz = [*numbers, 0.0, 0.0, 0.0][:6]
    return SetPoint(x, y, z, math.radians(rx), math.radians(ry), math.radians(rz))


class SetPointSocket(OperatorSocket):
    """Where set-points come in. The controller's role on the bus is held while it is open.

    Mutable state: the socket, and the senders that wait for an answer.
    """

    def __init__(self, interface: str, channel: str) -> None:
        """Listen. Raises RunError when the socket cannot be made."""
        super().__init__(socket_path(interface, channel), "set-point", LONGEST + 1)
        self._senders: list[str | bytes | None] = []

    def take(self) -> tuple[SetPoint, ...]:
        """Return what has come since the last call; what is no set-point is answered at once."""
        found: list[SetPoint] = []
        self._senders = []
        for data, sender in self._heard():
            try:
                found.append(parse(data.decode("ascii", "replace")))
            except ValueError as error:
                self._reply(f"refused: {error}".encode(), sender)
            else:
                self._senders.append(sender)
        return tuple(found)

    def answer(self, answers: Sequence[int]) -> None:
        """Tell the senders of the last set-points what became of them: bits of Refusal, in their order."""
        for sender, against in zip(self._senders, answers, strict=True):
            self._reply((f"refused: {explain(against)}" if against else TAKEN).encode(), sender)
        self._senders = []


class SetPointSender:
    """The other end: sends lines and waits for their answers. Mutable state: the socket."""

    def __init__(self, interface: str, channel: str) -> None:
        """Connect. Raises RunError when no controller listens."""
        path = socket_path(interface, channel)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self._socket.bind("")  # Linux gives it an address of its own, outside the file system
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise RunError(
                f"no controller takes set-points on bus {interface}:{channel}: start `hil run` with a "
                "reference of type live there first"
            ) from None
        self._socket.settimeout(ANSWER_S)

    def send(self, line: str) -> str:
        """Send one set-point and return the answer. Raises RunError when none comes."""
        try:
            self._socket.send(line.encode())
            return self._socket.recv(ANSWER_LONGEST).decode()
        except OSError:
            raise RunError(f"the controller did not answer within {ANSWER_S:g} s: has it ended?") from None

    def close(self) -> None:
        """Give the socket back."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
