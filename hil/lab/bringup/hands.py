"""Hands at a bench that another process serves: `hil plant --bench` has them, `hil bringup` asks them.

A datagram socket beside the bus's own files; a request is one line of JSON, and so is its answer. Readings
come from the bench's truth, with the errors of tape and gauge.
"""

import contextlib
import json
import os
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from drivers.bus_address import BusAddress
from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import RunError
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import refuse_on_trestles
from hil.app.plant import Bench
from hil.lab.bringup.context import Request
from hil.lab.bringup.machine import known_poses
from hil.lab.bringup.rehearsal import Agree, BenchHands, Hands, Say, build_bench, mounted, wiring_of

_LONGEST = 4096
_ENDED = "the bench has ended; its own last line says why"


def hands_socket(interface: str, channel: str) -> Path:
    """Return where the hands of a bus are asked."""
    return runtime_folder() / f"hands-{safe_name(interface)}-{safe_name(channel)}"


@contextlib.contextmanager
def served_bench(c: Configuration, mistakes: Sequence[str]) -> Iterator[Bench]:
    """Yield a bench with mistakes, whose hands are asked by a socket. Raises ConfigurationError, RunError."""
    refuse_on_trestles([] if c.plant is None else c.plant.faults)
    path = hands_socket(c.bus.interface, c.bus.channel)
    if asked(path):
        raise RunError(f"{path}: another bench is served on this bus; end it first")
    bench = build_bench(c, wiring_of(mistakes, build_protocol(c)))
    with (
        contextlib.closing(mounted(c, bench.wiring)) as platform,
        contextlib.closing(_bound(path)) as door,
    ):
        hands = BenchHands(bench, known_poses(c), platform=platform)
        try:
            yield Bench(bench.nodes, bench.cables, lambda: _serve(door, hands))
        finally:
            path.unlink(missing_ok=True)


def asked(path: Path) -> bool:
    """Tell whether somebody serves hands there."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _bound(path: Path, server: Path | None = None) -> socket.socket:
    """Return a socket at a path, connected to a server where there is one. Raises RunError."""
    door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    door.setblocking(False)
    try:
        path.unlink(missing_ok=True)
        door.bind(str(path))
        if server is not None:
            door.connect(str(server))
    except OSError as error:
        door.close()
        what = "the bench's hands cannot listen there" if server is None else "nobody serves a bench there"
        raise RunError(f"{server or path}: {what}: {error}") from None
    return door


def _serve(door: socket.socket, hands: BenchHands) -> None:
    """Do what has been asked for, and answer."""
    with contextlib.suppress(BlockingIOError):
        data, sender = door.recvfrom(_LONGEST)
        act, leg, value = json.loads(data)
        hands.ask(Request(act, leg, value))
        with contextlib.suppress(OSError):
            door.sendto(json.dumps(hands.answer()).encode(), sender)


class RemoteHands(Hands):
    """The hands of a served bench. Mutable state: the socket."""

    def __init__(self, address: BusAddress, agree: Agree, say: Say) -> None:
        """Ask the hands of a bus. Raises RunError where there are none."""
        super().__init__(agree, say)
        self._server = hands_socket(address.interface, address.channel)
        self._own = self._server.with_name(f"{self._server.name}-{os.getpid()}")
        self._socket = _bound(self._own, self._server)

    def ask(self, request: Request) -> None:
        """Send what is to be done."""
        self._say(f"    {request.text}")
        try:
            self._socket.send(json.dumps([request.act, request.leg, request.value]).encode())
        except OSError:
            raise RunError(_ENDED) from None

    def answer(self) -> float | None:
        """Return the bench's answer once it is there."""
        try:
            return float(json.loads(self._socket.recv(_LONGEST)))
        except OSError as error:
            if isinstance(error, BlockingIOError) and asked(self._server):
                return None
            raise RunError(_ENDED) from None

    def close(self) -> None:
        """Leave the hands alone."""
        self._socket.close()
        self._own.unlink(missing_ok=True)
