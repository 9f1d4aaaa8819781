"""The loop's end of the operator channel: clients of this user on a socket, read between two ticks.

The work in a tick is bounded: at most AT_MOST lines are read and answered, none is waited for, none raises.
Clients take turns: one that floods delays no other's line, and one that does not read its answers is dropped.
"""

import select
import socket
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

from drivers.errors import RunError
from hil.operate.client import REFUSED, TAKEN, socket_path
from hil.operate.words import Said, parse, split
from hil.signals import Operator, Order, SetPoint

AT_MOST = 8
"""Lines read in one tick."""
MOST_CLIENTS = 128
"""At once; the one that has said nothing for the longest makes room."""
_READ = 4096
"""Bytes of a line that are read; allowed are far fewer."""
_STATUS = len(Said._fields)
"""What a line is of: a field of `Said`, or this."""


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
        self._waiting: list[tuple[int, str, socket.socket]] = []
        """What was said, the tag, and the client of each line that has no answer yet."""
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

    @property
    def waited_for(self) -> bool:
        """Whether somebody waits for an answer."""
        return bool(self._waiting)

    def take(self, at_most: int = AT_MOST, *, anew: bool = False) -> Heard:
        """Return what has come since the last call; what is no word is answered at once.

        anew: what waits now is old, also where it is read in a later tick. A client that has more waiting at
        each tick until then says nothing new.
        """
        self._waiting.clear()
        self.old = frozenset()
        ready = self._polled()
        if not ready:
            self._old.clear()
            return SILENCE
        self._old = ready if anew else self._old & ready
        if self._socket.fileno() in ready:
            new, ready = self._welcome(at_most), self._polled()
            if self._socket.fileno() in self._old:
                self._old |= new & ready
        heard: list[list[Any]] = [[], [], []]
        old: set[int] = set()
        for data, client, is_old in self._lines(at_most, ready):
            text = data.decode("ascii", "replace")
            tag, line = split(text) if len(data) < _READ else ("", text)  # cut off, maybe within a number
            try:
                said = parse(line)
            except ValueError as error:
                self.malformed += 1
                self._reply(client, f"{tag}{REFUSED}{error}")
                continue
            kind = next((k for k, each in enumerate(said) if each is not None), _STATUS)
            self._waiting.append((kind, tag, client))
            if kind == 0 and is_old:
                old.add(len(heard[kind]))
            if kind != _STATUS:
                heard[kind].append(said[kind])
        self.old = frozenset(old)
        return Heard(*map(tuple, heard))

    def _polled(self) -> set[int]:
        """Who has something to read, the socket on which clients are let in among them."""
        return {number for number, _ in self._ready.poll(0.0, MOST_CLIENTS + 1)}

    def _lines(self, at_most: int, ready: set[int]) -> list[tuple[bytes, socket.socket, bool]]:
        """Return lines with their clients and whether they may be old, one of each client in turn."""
        turns = deque(number for number in self._clients if number in ready)
        lines: list[tuple[bytes, socket.socket, bool]] = []
        for _ in range(2 * at_most):  # those who come and go are no lines, and bounded too
            if not turns or len(lines) == at_most:
                break
            number = turns.popleft()
            client = self._clients[number]
            try:
                data = client.recv(_READ)
            except (BlockingIOError, ConnectionResetError):
                continue  # no more; or gone without its answers: what it said is still there
            except OSError:
                data = b""
            if data:
                self._clients[number] = self._clients.pop(number)
                lines.append((data, client, number in self._old))
                turns.append(number)
            else:
                self._drop(client)
        return lines

    def _welcome(self, at_most: int) -> set[int]:
        """Take the next clients in; return their numbers."""
        found: set[int] = set()
        for _ in range(at_most):
            try:
                client, _ = self._socket.accept()
            except OSError:  # no more, or gone again
                break
            client.setblocking(False)
            if len(self._clients) >= MOST_CLIENTS:
                self._drop(next(iter(self._clients.values())))
            self._clients[client.fileno()] = client
            self._ready.register(client, select.EPOLLIN)
            found.add(client.fileno())
        return found

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
        refusals = [iter(each) for each in (operator, orders, setpoints)]
        for kind, tag, client in self._waiting:
            if kind == _STATUS:
                text = status()
            else:
                why = next(refusals[kind])
                text = f"{REFUSED}{why}" if why else TAKEN
            self._reply(client, tag + text)
        self._waiting.clear()

    def close(self) -> None:
        """Stop listening and remove the socket."""
        for client in self._clients.values():
            client.close()
        self._clients.clear()
        self._ready.close()
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def _reply(self, client: socket.socket, answer: str) -> None:
        try:
            client.send(answer.encode())
        except OSError:  # gone, or it does not read its answers
            self._drop(client)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
