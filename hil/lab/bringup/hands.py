"""Hands at a bench that another process serves: `hil plant --bench` has them, `hil bringup` asks them.

A datagram socket beside the bus's own files; a request is one line of JSON, and so is its answer. Readings
come from the bench's truth, with the errors of tape and gauge.
"""

import contextlib
import json
import math
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import get_args

from drivers.bus_address import BusAddress
from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import RunError
from drivers.signals import LEGS
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import refuse_on_trestles
from hil.app.plant import Bench
from hil.lab.bringup.context import Act, Operator, Request
from hil.lab.bringup.machine import known_poses
from hil.lab.bringup.rehearsal import PATIENCE, BenchHands, build_bench, mounted, wiring_of

_LONGEST = 4096


def hands_socket(interface: str, channel: str) -> Path:
    """Return where the hands of a bus are asked."""
    return runtime_folder() / f"hands-{safe_name(interface)}-{safe_name(channel)}"


@contextlib.contextmanager
def served_bench(c: Configuration, mistakes: Sequence[str]) -> Iterator[Bench]:
    """Yield a bench wired with some mistakes, whose hands are asked by a socket.

    Raises ConfigurationError for mistakes that are none, and for faults, of which the process's own alone can
    strike there; RunError where somebody else serves them.
    """
    refuse_on_trestles([] if c.plant is None else c.plant.faults)
    path = hands_socket(c.bus.interface, c.bus.channel)
    if asked(path):
        raise RunError(f"{path}: another bench is served on this bus; end it first")
    bench = build_bench(c, wiring_of(mistakes, build_protocol(c)))
    platform = mounted(c, bench.wiring)
    hands = BenchHands(bench, known_poses(c), mounted=lambda: platform)
    with contextlib.ExitStack() as stack:
        stack.callback(platform.close)
        door = stack.enter_context(contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)))
        door.setblocking(False)
        try:
            path.unlink(missing_ok=True)
            door.bind(str(path))
        except OSError as error:
            raise RunError(f"{path}: the bench's hands cannot listen there: {error}") from None
        stack.callback(path.unlink, missing_ok=True)
        yield Bench(bench.nodes, bench.cables, lambda: _serve(door, hands))


def asked(path: Path) -> bool:
    """Tell whether somebody serves hands there."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _serve(door: socket.socket, hands: BenchHands) -> None:
    """Do what has been asked for, and answer."""
    with contextlib.suppress(BlockingIOError):
        data, sender = door.recvfrom(_LONGEST)
        try:
            act, leg, value = json.loads(data)
            request = Request(act, int(leg), float(value))
        except (TypeError, ValueError, OverflowError, RecursionError):
            return  # no request of a bring-up
        if act not in get_args(Act) or not -1 <= request.leg < LEGS or not math.isfinite(request.value):
            return
        try:
            hands.ask(request)
        except LookupError:
            return  # there is no such pose
        if sender is None:
            return  # whose socket has no name cannot be told
        with contextlib.suppress(OSError):
            door.sendto(json.dumps(hands.answer()).encode(), sender)


class RemoteHands:
    """The operator whose hands are those of a served bench; consent and words are `beside`'s.

    Mutable state: the socket.
    """

    patience: float = PATIENCE

    def __init__(self, address: BusAddress, beside: Operator, agree: Callable[[str, str, str], bool]) -> None:
        """Ask the hands of a bus. Raises RunError where there are none."""
        self._beside, self._agree = beside, agree
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._server = server = hands_socket(address.interface, address.channel)
        self._own = server.with_name(f"{server.name}-{os.getpid()}")
        try:
            self._own.unlink(missing_ok=True)
            self._socket.bind(str(self._own))
            self._socket.connect(str(server))
        except OSError as error:
            self.close()
            raise RunError(f"{server}: nobody serves a bench there ({error.strerror})") from None

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Ask who rehearses."""
        return self._agree(title, will, stop)

    def tell(self, text: str) -> None:
        """Say it."""
        self._beside.tell(text)

    def ask(self, request: Request) -> None:
        """Send what is to be done."""
        self._beside.tell(f"    {request.text}")
        try:
            self._socket.send(json.dumps([request.act, request.leg, request.value]).encode())
        except OSError as error:
            raise RunError(f"the bench does not answer any more: {error.strerror}") from None

    def answer(self) -> float | None:
        """Return the bench's answer once it is there."""
        try:
            answer = json.loads(self._socket.recv(_LONGEST))
        except BlockingIOError:
            if asked(self._server):
                return None
            raise RunError("the bench has ended; its own last line says why") from None
        except OSError as error:
            raise RunError(f"the bench does not answer any more: {error.strerror}") from None
        return None if answer is None else float(answer)

    def close(self) -> None:
        """Leave the hands alone."""
        self._socket.close()
        self._own.unlink(missing_ok=True)
