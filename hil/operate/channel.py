"""The loop's end of the operator channel: a socket for clients of this user, read between two ticks.

The work in a tick is bounded: it reads and answers at most AT_MOST lines, waits for none, and raises nothing.
Clients take turns: a client that floods the channel delays no other client's line. A client that does not
read its answers is dropped.
"""

import select
import socket
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

from drivers.errors import RunError
from hil.operate.client import REFUSED, TAKEN, socket_path
from hil.operate.commands import ParsedLine, parse, split
from hil.signals import Operator, Order, SetPoint

AT_MOST = 8
"""Most lines read in one tick."""
MOST_CLIENTS = 128
"""Clients at once; beyond that the one with the longest silence is dropped."""
_READ = 4096
"""Bytes of a line that are read; valid lines are far shorter."""
_STATUS = len(ParsedLine._fields)
"""Kind of a line: the index of a field of `ParsedLine`, or this."""


class Heard(NamedTuple):
    """The operator's input since the last tick: commands, motion orders and set-points, each in order."""

    operator: tuple[Operator, ...] = ()
    orders: tuple[Order, ...] = ()
    setpoints: tuple[SetPoint, ...] = ()


SILENCE = Heard()


class OperatorChannel:
    """Socket on which the loop receives the operator's lines; only the controller on a bus may open it.

    Mutable state: the socket, the clients, which of them may have old lines, lines without an answer yet, and
    the number of malformed lines.
    """

    def __init__(self, interface: str, channel: str) -> None:
        """Listen on the operator socket of a bus. Raises RunError if the socket cannot be created."""
        self.path = socket_path(interface, channel)
        self.malformed = 0
        self._clients: dict[int, socket.socket] = {}
        """Clients by file descriptor, the latest sender last."""
        self._old: set[int] = set()
        self.old: frozenset[int] = frozenset()
        """Indices, in the last commands, of those that may have waited since before the last `mark_old`."""
        self._waiting: list[tuple[int, str, socket.socket]] = []
        """Kind, tag and client of each line without an answer yet."""
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
        """True while a client waits for an answer to its line."""
        return bool(self._waiting)

    def take(self, at_most: int = AT_MOST, *, mark_old: bool = False) -> Heard:
        """The operator's input since the last call; a malformed line is answered at once.

        mark_old: lines that wait now count as old, even if they are read in a later tick. A client that
        always has another line waiting has only old lines until it pauses.
        """
        self._waiting.clear()
        self.old = frozenset()
        ready = self._polled()
        if not ready:
            self._old.clear()
            return SILENCE
        self._old = ready if mark_old else self._old & ready
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
        """File descriptors with data to read, including the listening socket's."""
        return {number for number, _ in self._ready.poll(0.0, MOST_CLIENTS + 1)}

    def _lines(self, at_most: int, ready: set[int]) -> list[tuple[bytes, socket.socket, bool]]:
        """(line, client, may be old) for at most `at_most` lines, one from each client in turn."""
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
        """Answer the last lines, each kind in order: the reason for a refusal, or empty text: accepted.

        `status` returns the answer to a status line.
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
        """Stop listening and remove the socket file."""
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
