"""The loop's end of the operator channel: clients of this user on a socket, read between two ticks.

Bounded work in a tick, whoever sends how much: at most AT_MOST lines are read and answered, none is waited
for, and none raises. Each client has a connection of its own, and takes its turn: one that floods delays no
other's line, and one that does not read its answers is dropped before it costs the others theirs.
"""

import select
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
MOST_CLIENTS = 128
"""At once; the one that has said nothing for the longest makes room."""
_LONGEST = LONGEST + 18
"""With a tag."""
_Waiting = list[tuple[str, socket.socket]]


class Heard(NamedTuple):
    """What the operator has said since the last tick, each kind in its order."""

    operator: tuple[Operator, ...] = ()
    orders: tuple[Order, ...] = ()
    setpoints: tuple[SetPoint, ...] = ()


SILENCE = Heard()


class OperatorChannel:
    """Where the operator's lines come in. The controller's role on the bus is held while it is open.

    Mutable state: the socket, the clients, which of them may have lines that are old, who waits for which
    answer, and how many lines were no words.
    """

    def __init__(self, interface: str, channel: str) -> None:
        """Listen. Raises RunError when the socket cannot be made."""
        self.path = socket_path(interface, channel)
        self.malformed = 0
        self._clients: dict[int, socket.socket] = {}
        """By file descriptor; who spoke last comes last."""
        self._old: set[int] = set()
        self.old: frozenset[int] = frozenset()
        """Places, in the commands heard last, of what may have waited since before the last `anew`."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_CLOEXEC)
        try:
            self.path.unlink(missing_ok=True)  # left by a controller that was killed: we hold its role now
            self._socket.bind(str(self.path))
            self.path.chmod(0o600)
            self._socket.listen(MOST_CLIENTS)
        except OSError as error:
            self._socket.close()
            raise RunError(f"operator socket {self.path}: {error.strerror or error}") from error
        self._socket.setblocking(False)
        self._ready = select.epoll()
        self._ready.register(self._socket, select.EPOLLIN)
        self.waited_for = False
        """Whether somebody waits for an answer."""
        self._forget()

    def take(self, at_most: int = AT_MOST, *, anew: bool = False) -> Heard:
        """Return what has come since the last call; what is no word is answered at once.

        anew: what waits now is old, also where it is read in a later tick. A client that has more waiting at
        each tick until then says nothing new.
        """
        if self.waited_for:
            self._forget()
        if anew or self._old:
            waiting = {number for number, _ in self._ready.poll(0.0, MOST_CLIENTS + 1)}
            self._old = waiting if anew else self._old & waiting
        lines = self._lines(at_most)
        self.old = frozenset()
        if not lines:
            return SILENCE
        operator: list[Operator] = []
        orders: list[Order] = []
        setpoints: list[SetPoint] = []
        old: set[int] = set()
        for data, client, is_old in lines:
            tag, line = split(data.decode("ascii", "replace"))
            if len(data) > _LONGEST:  # cut off, maybe within a number
                line = data.decode("ascii", "replace")
            try:
                said = parse(line)
            except ValueError as error:
                self.malformed += 1
                self._reply((tag, client), f"{REFUSED}{error}")
                continue
            if said.operator is not None:
                if is_old:
                    old.add(len(operator))
                operator.append(said.operator)
                self._operator.append((tag, client))
            elif said.order is not None:
                orders.append(said.order)
                self._orders.append((tag, client))
            elif said.setpoint is not None:
                setpoints.append(said.setpoint)
                self._setpoints.append((tag, client))
            else:
                self._status.append((tag, client))
            self.waited_for = True
        self.old = frozenset(old)
        return Heard(tuple(operator), tuple(orders), tuple(setpoints))

    def _lines(self, at_most: int) -> list[tuple[bytes, socket.socket, bool]]:
        """Return lines with their clients and whether they may be old, one of each client in turn."""
        lines: list[tuple[bytes, socket.socket, bool]] = []
        looks = 2 * at_most  # those who come and go are no lines, and bounded too
        while looks > 0 and (ready := self._ready.poll(0.0, min(at_most - len(lines), MOST_CLIENTS))):
            looks -= len(ready)
            for number, _ in ready:
                client = self._clients.get(number)
                if client is None:
                    if number == self._socket.fileno():
                        self._welcome()
                    continue
                try:
                    data = client.recv(_LONGEST + 1)
                except (BlockingIOError, ConnectionResetError):
                    continue  # another one by now; or gone without its answers: what it said is still there
                except OSError:
                    data = b""
                if data:
                    self._clients[number] = self._clients.pop(number)
                    lines.append((data, client, number in self._old))
                else:
                    self._drop(client)
            if len(lines) >= at_most:
                break
        return lines

    def _welcome(self) -> None:
        """Take the next client in."""
        try:
            client, _ = self._socket.accept()
        except OSError:  # it has gone again
            return
        client.setblocking(False)
        if len(self._clients) >= MOST_CLIENTS:
            self._drop(next(iter(self._clients.values())))
        self._clients[client.fileno()] = client
        if self._socket.fileno() in self._old and _has_spoken(client):
            self._old.add(client.fileno())
        self._ready.register(client, select.EPOLLIN)

    def _drop(self, client: socket.socket) -> None:
        """Let a client go, if it is still there."""
        if self._clients.pop(client.fileno(), None) is not None:
            self._old.discard(client.fileno())
            client.close()

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
            for asking, refusal in zip(waiting, refusals, strict=True):
                self._reply(asking, f"{REFUSED}{refusal}" if refusal else TAKEN)
        if self._status:
            text = status()
            for asking in self._status:
                self._reply(asking, text)
        self._forget()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        self._ready.close()
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def _forget(self) -> None:
        self.waited_for = False
        self._operator: _Waiting = []
        self._orders: _Waiting = []
        self._setpoints: _Waiting = []
        self._status: _Waiting = []

    def _reply(self, to: tuple[str, socket.socket], answer: str) -> None:
        tag, client = to
        try:
            client.send(f"{tag}{answer}".encode())
        except OSError:  # gone, or it does not read its answers
            self._drop(client)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _has_spoken(client: socket.socket) -> bool:
    try:
        client.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return False
    except OSError:  # gone, maybe with words that are still there
        return True
    return True
