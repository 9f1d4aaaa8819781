"""The loop's end of the operator channel: datagrams on a socket of this user, read between two ticks.

Bounded work in a tick, whoever sends how much: at most AT_MOST lines are read and answered, none is waited
for, and none raises.
"""

import contextlib
import socket
from collections.abc import Callable, Sequence
from typing import NamedTuple, Self

from drivers.errors import RunError
from hil.operate.answers import REFUSED, TAKEN
from hil.operate.client import socket_path
from hil.operate.words import LONGEST, parse, split
from hil.signals import Operator, Order, SetPoint

AT_MOST = 8
"""Lines read in one tick."""
QUEUED = 4096
"""More lines than can wait in a socket."""
_LONGEST = LONGEST + 18
"""With a tag."""
Sender = str | bytes | None
_Waiting = list[tuple[str, Sender]]


class Heard(NamedTuple):
    """What the operator has said since the last tick, each kind in its order."""

    operator: tuple[Operator, ...] = ()
    orders: tuple[Order, ...] = ()
    setpoints: tuple[SetPoint, ...] = ()


SILENCE = Heard()


class OperatorChannel:
    """Where the operator's lines come in. The controller's role on the bus is held while it is open.

    Mutable state: the socket, who waits for which answer, and how many lines were no words.
    """

    def __init__(self, interface: str, channel: str) -> None:
        """Listen. Raises RunError when the socket cannot be made."""
        self.path = socket_path(interface, channel)
        self.malformed = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self.path.unlink(missing_ok=True)  # left by a controller that was killed: we hold its role now
            self._socket.bind(str(self.path))
            self.path.chmod(0o600)
        except OSError as error:
            self._socket.close()
            raise RunError(f"operator socket {self.path}: {error.strerror or error}") from error
        self._socket.setblocking(False)
        self.waited_for = False
        """Whether somebody waits for an answer."""
        self._forget()

    def take(self, at_most: int = AT_MOST) -> Heard:
        """Return what has come since the last call; what is no word is answered at once."""
        if self.waited_for:
            self._forget()
        lines = self._lines(at_most)
        if not lines:
            return SILENCE
        operator: list[Operator] = []
        orders: list[Order] = []
        setpoints: list[SetPoint] = []
        for data, sender in lines:
            tag, line = split(data.decode("ascii", "replace"))
            if len(data) > _LONGEST:  # cut off, maybe within a number
                line = data.decode("ascii", "replace")
            try:
                said = parse(line)
            except ValueError as error:
                self.malformed += 1
                self._reply((tag, sender), f"{REFUSED}{error}")
                continue
            if said.operator is not None:
                operator.append(said.operator)
                self._operator.append((tag, sender))
            elif said.order is not None:
                orders.append(said.order)
                self._orders.append((tag, sender))
            elif said.setpoint is not None:
                setpoints.append(said.setpoint)
                self._setpoints.append((tag, sender))
            else:
                self._status.append((tag, sender))
            self.waited_for = True
        return Heard(tuple(operator), tuple(orders), tuple(setpoints))

    def _lines(self, at_most: int) -> list[tuple[bytes, Sender]]:
        lines: list[tuple[bytes, Sender]] = []
        with contextlib.suppress(OSError):  # nothing more is there
            while len(lines) < at_most:
                lines.append(self._socket.recvfrom(_LONGEST + 1))
        return lines

    def answer(
        self,
        operator: Sequence[str],
        orders: Sequence[str],
        setpoints: Sequence[str],
        status: Callable[[], str],
    ) -> None:
        """Tell the senders of the last lines why each was refused; empty where it was taken.

        `status` gives the answer to who asked for it.
        """
        for waiting, refusals in (
            (self._operator, operator),
            (self._orders, orders),
            (self._setpoints, setpoints),
        ):
            for sender, refusal in zip(waiting, refusals, strict=True):
                self._reply(sender, f"{REFUSED}{refusal}" if refusal else TAKEN)
        if self._status:
            text = status()
            for sender in self._status:
                self._reply(sender, text)
        self._forget()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def _forget(self) -> None:
        self.waited_for = False
        self._operator: _Waiting = []
        self._orders: _Waiting = []
        self._setpoints: _Waiting = []
        self._status: _Waiting = []

    def _reply(self, to: tuple[str, Sender], answer: str) -> None:
        tag, sender = to
        if sender:  # a sender without an address does not want one
            with contextlib.suppress(OSError):  # gone, or it does not read its answers
                self._socket.sendto(f"{tag}{answer}".encode(), sender)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
