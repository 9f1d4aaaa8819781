"""Connects a bring-up to its drives: real drives on a bus, or a bench that another process emulates there.

`hil plant --bench` also simulates the operator's hands. `hil bringup` reaches them through a datagram socket
next to the bus's own files; request and answer are JSON. Readings are the bench's true values with the errors
of tape and gauge.
"""

import contextlib
import json
import os
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path

from drivers.bus_address import BusAddress
from drivers.can.bus import Bus
from drivers.can.runtime_folder import runtime_folder, safe_name
from drivers.errors import BusError, RunError
from drivers.family import Family
from drivers.frame_array import joined, received_frames, sent_array
from drivers.protocol import Frame
from hil.app.compose import build_protocol, drive_setup
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import require_bench_faults
from hil.app.plant import Bench
from hil.app.run.stretching import STRANGER, begin, bench_clock
from hil.lab.bringup.context import Operator, Request
from hil.lab.bringup.drives import Heard, Line
from hil.lab.bringup.machine import WINDOW, bringup_rate, known_poses
from hil.lab.bringup.rehearsal import Agree, BenchHands, Hands, Say, build_bench, mounted, wiring_of
from hil.loop.clock import Deadlines, real_time
from hil.loop.report import NO_WATCHDOG

_LONGEST = 4096
_ENDED = "the bench has ended; its last line of output gives the reason"


class BusLine:
    """Exchanges frames on an open bus, tick by tick. Mutable state: deadlines, bus, total pause."""

    def __init__(self, bus: Bus, rate_Hz: float, window_s: float, *, watched: bool) -> None:
        """window_s: longest wait for answers in a tick, s; watched: the drives have watchdogs."""
        self.rate_Hz, self._bus = rate_Hz, bus
        self._left = "the drives' watchdogs shut their brakes" if watched else f"the drives {NO_WATCHDOG}"
        self._deadlines = Deadlines(rate_Hz, 0.0, clock=bus.clock)
        self._window_ns = round(1e9 * window_s)
        self._rest_ns = self._deadlines.period_ns - self._window_ns
        self._stood_ns = bus.clock.stretched()
        bus.flush_tx()
        bus.drain_now()

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Wait for the next tick, send `opening`, collect answers. Raises BusError if the bus is off."""
        _, t_ns, lateness_ns, _ = self._deadlines.wait()
        began = t_ns + lateness_ns
        before_ns, self._stood_ns = self._stood_ns, self._bus.clock.stretched()
        frames = [self._bus.drain_now()]
        self._bus.send(sent_array(opening))
        end = began + self._window_ns
        while self._bus.clock.now() < end:
            heard = self._bus.wait(end)
            if not len(heard):
                break
            frames.append(heard)
        self._bus.clock.working(self._rest_ns)
        if self._bus.events().off:
            raise BusError(f"the bus is down: {self._left}; look at cable and power")
        return Heard(began, received_frames(joined(frames)), self._stood_ns - before_ns)

    def send(self, frames: Sequence[Frame]) -> None:
        """Send the frames that end a tick."""
        self._bus.send(sent_array(frames))


@contextlib.contextmanager
def served_end(
    c: Configuration, bus: Bus, protocol: Family, person: Operator, agree: Agree, say: Say
) -> Iterator[tuple[Line, Operator]]:
    """Yield (bus line, simulated operator) of a bench in another process; the bench's time may pause."""
    say("a rehearsal bench is served on this bus: it does the requested actions by itself")
    clock, rate = bench_clock(c, bus), bringup_rate(c)

    def unheld(title: str, will: str, stop: str) -> bool:  # a person may think: nobody's time is held
        bus.clock.leave()
        try:
            return agree(title, will, stop)
        finally:
            if clock is not None:
                clock.holds = True

    hands = RemoteHands(BusAddress(c.bus.interface, c.bus.channel), unheld, person.tell)
    with contextlib.closing(hands), real_time(c.loop.priority, c.loop.cpu):
        if clock is not None:
            opening = protocol.controller_end(drive_setup(c, rate)).begin(0)
            begin(clock, c, protocol, opening, round(1e9 * WINDOW / rate))
        try:
            yield bus_line(c, bus, protocol), hands
        finally:
            bus.clock.leave()
            if clock is not None and clock.interrupted:
                say(STRANGER)


def bus_line(c: Configuration, bus: Bus, protocol: Family) -> BusLine:
    """Exchange of frames on an open bus at the tick rate of a bring-up."""
    rate = bringup_rate(c)
    return BusLine(bus, rate, WINDOW / rate, watched=protocol.traits.has_watchdog)


def hands_socket(interface: str, channel: str) -> Path:
    """Path of the Unix socket to the simulated operator of a bench that is served on a bus."""
    return runtime_folder() / f"hands-{safe_name(interface)}-{safe_name(channel)}"


@contextlib.contextmanager
def served_bench(c: Configuration, mistakes: Sequence[str]) -> Iterator[Bench]:
    """Yield an emulated bench with mistakes, and serve its operator. Raises ConfigurationError, RunError."""
    require_bench_faults([] if c.plant is None else c.plant.faults)
    path = hands_socket(c.bus.interface, c.bus.channel)
    if is_served(path):
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


def is_served(path: Path) -> bool:
    """True if a process serves the simulated operator of a bench at this socket."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _bound(path: Path, server: Path | None = None) -> socket.socket:
    """A socket bound to a path, and connected to `server` if given. Raises RunError."""
    door = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    door.setblocking(False)
    try:
        path.unlink(missing_ok=True)
        door.bind(str(path))
        if server is not None:
            door.connect(str(server))
    except OSError as error:
        door.close()
        what = "cannot serve the bench's hands there" if server is None else "no bench is served there"
        raise RunError(f"{server or path}: {what}: {error}") from None
    return door


def _serve(door: socket.socket, hands: BenchHands) -> None:
    """Answer one pending request to the simulated operator, if any."""
    with contextlib.suppress(BlockingIOError):
        data, sender = door.recvfrom(_LONGEST)
        act, leg, value = json.loads(data)
        hands.ask(Request(act, leg, value))
        with contextlib.suppress(OSError):
            door.sendto(json.dumps(hands.answer()).encode(), sender)


class RemoteHands(Hands):
    """Simulated operator of a bench that another process emulates. Mutable state: the socket."""

    def __init__(self, address: BusAddress, agree: Agree, say: Say) -> None:
        """Connect to the simulated operator on a bus. Raises RunError if no bench is served there."""
        super().__init__(agree, say)
        self._server = hands_socket(address.interface, address.channel)
        self._own = self._server.with_name(f"{self._server.name}-{os.getpid()}")
        self._socket = _bound(self._own, self._server)

    def ask(self, request: Request) -> None:
        """Show the request and send it to the bench. Raises RunError once the bench has ended."""
        self._say(f"    {request.text}")
        try:
            self._socket.send(json.dumps([request.act, request.leg, request.value]).encode())
        except OSError:
            raise RunError(_ENDED) from None

    def answer(self) -> float | None:
        """The bench's reading, 0 for an action done, None until it arrives. Raises RunError at its end."""
        try:
            return float(json.loads(self._socket.recv(_LONGEST)))
        except OSError as error:
            if isinstance(error, BlockingIOError) and is_served(self._server):
                return None
            raise RunError(_ENDED) from None

    def close(self) -> None:
        """Close the socket and remove its file."""
        self._socket.close()
        self._own.unlink(missing_ok=True)
