"""Bus: the door to the CAN bus, whatever interface is behind it.

Frames go out and come in as they are, elements of FRAME; what they mean is the protocol's.
"""

from __future__ import annotations

import select
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from typing import Any, NamedTuple, Self

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus_time import BitTiming
from drivers.can.can_interface import RESTART_MS
from drivers.can.link import Link, Source, collect
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.participant import LOOK_S, Participant
from drivers.can.python_can import open_python_can
from drivers.can.runtime_folder import RoleLock
from drivers.can.socketcan import SocketCan
from drivers.clock import MONOTONIC
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import joined
from drivers.protocol import ERROR
from drivers.signals import BusState

DEAD_AFTER_NS = 50_000_000
"""A bus that takes no frame at all for this long is dead; for less, it is busy."""
_FIRST_LOOK_NS = 200_000
"""Between two looks at a link that cannot be waited for together with others."""


class BusEvents(NamedTuple):
    """What happened on the bus beside frames since the last call."""

    errors: int
    """Error frames."""
    off: int
    """Bit i: bus i is off or down as of now, has taken no frame for `DEAD_AFTER_NS`, or was bus-off since the
    last call."""
    overflow: int
    """Received frames that were lost because they were not read in time."""
    state: BusState = BusState.UNKNOWN
    """The worst state of the CAN controller since the last call."""


class Bus(Source):
    """An open bus, or several as one; each frame says on which it is.

    `clock` is that of its frames' times and of all deadlines: of the links, where all have the same.

    `knows_ends`: whether `sent_ns` says when frames ended on each wire. `virtual`: whether frames of a bus
    are there as soon as they are sent: no wire takes its time.

    Mutable state: the links, in the order of their buses; the error count since the last `events`, which
    buses were off then, and the worst state of each; since when each refuses frames, and whether it is dead;
    on which each identifier was last received, and each frame of the last `send` went.
    """

    def __init__(self, links: Sequence[Link], role: RoleLock | ExitStack | None = None) -> None:
        self._links = tuple(links)
        clocks = {id(link.clock) for link in self._links}
        self.clock = self._links[0].clock if len(clocks) == 1 else MONOTONIC
        self.knows_ends = all(link.knows_ends for link in self._links)
        self.virtual = any(link.virtual for link in self._links)
        self._role = role
        self._errors = self._overflow_seen = self._was_off = 0
        self._home: dict[int, int] = {}
        self._order: list[int] = []
        self._refused_since = [0] * len(self._links)
        self._dead = [False] * len(self._links)
        self._states = [BusState.UNKNOWN] * len(self._links)

    @property
    def facts(self) -> str:
        """What was read of the interfaces, in one line; empty where there is nothing to read."""
        return "; ".join(link.facts for link in self._links if link.facts)

    @classmethod
    def open(cls, settings: BusSettings, role: str) -> Bus:
        """Open the bus of the configuration.

        role: at most one process has it on a channel of this machine; on one of localcan, in its runtime
        folder. Several `localcan` channels go by the clock of the first.
        Raises RunError when another process has the role, BusError when the bus cannot be opened.
        """
        links: list[Link] = []
        with ExitStack() as roles, ExitStack() as opened:
            clock: BenchClock | None = None
            for each in settings.buses:
                roles.callback(RoleLock(each.interface, each.channel, role).close)
                link = _open(each, clock)
                opened.callback(link.close)
                links.append(link)
                clock = link.clock if isinstance(link, Participant) else clock
            opened.pop_all()
            return cls(links, roles.pop_all())

    def send(self, frames: Rows) -> int:
        """Send frames, each on its bus; return the number of those that were not taken.

        Each bus takes its own from the first on. A refusal that passes is a busy bus; one that lasts makes
        `events().off`. Does not wait for the buses, and raises only for frames that one cannot carry at all
        (BusError): the others still get theirs, which may be an emergency stop.
        """
        self._order = frames["bus"].tolist()
        taken = 0
        failed: Exception | None = None
        for bus, link in enumerate(self._links):
            own, took = frames[frames["bus"] == bus], 0
            if not len(own):
                continue
            try:
                took = link.send(own)
            except Exception as error:  # noqa: BLE001 - raised when all have theirs
                failed = failed or error
            taken += took
            now = self.clock.now()
            self._refused_since[bus] = since = 0 if took else self._refused_since[bus] or now
            self._dead[bus] = not took and now - since >= DEAD_AFTER_NS
        if failed is not None:
            raise failed
        return len(frames) - taken

    def receive(self) -> Rows:
        """Return what is there on all buses, error frames included, in the order of time."""
        parts = [link.receive() for link in self._links]
        if len(parts) == 1:
            return parts[0]
        received = joined(parts)
        buses = [bus for bus, part in enumerate(parts) for _ in range(len(part))]
        if not buses:
            return received
        received["bus"] = buses
        self._home.update(zip(received["id"].tolist(), buses, strict=True))
        return received[np.argsort(received["t_ns"], kind="stable")]

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        """Sleep until there may be more, at most until the deadline.

        What is missing is awaited bus by bus, each identifier on the bus where it was last heard; where
        that is not known, or anything is awaited, on all buses together.
        """
        if len(self._links) == 1:
            self._links[0].block(deadline_ns, missing)
            return
        if missing and missing <= self._home.keys():
            bus = min(self._home[identifier] for identifier in missing)
            there = {identifier for identifier in missing if self._home[identifier] == bus}
            self._links[bus].block(deadline_ns, there)
            return
        clock = self.clock
        ends = [end for link in self._links if (end := link.foresee()) is not None]
        if ends:
            clock.sleep_until(min(*ends, deadline_ns))
            return
        files = [link.fileno() for link in self._links]
        if min(files) < 0:
            clock.sleep_until(min(deadline_ns, clock.now() + _FIRST_LOOK_NS))
            return
        clock.waiting(deadline_ns)
        quiet = [link.arm() for link in self._links]
        left_s = (deadline_ns - clock.now()) * 1e-9
        if all(quiet) and left_s > 0:
            stands = self._off_bits() != 0 or clock.stands()
            select.select(files, [], [], min(left_s, LOOK_S) if stands else left_s)
        clock.working()

    def drain(self, deadline_ns: int, wanted: AbstractSet[int]) -> Rows:
        """Return all frames in the order received, as soon as one of every wanted identifier has come.

        Returns at the deadline with what is there. What came before the call counts: to wait for answers,
        `drain_now` before asking. An empty `wanted` is fulfilled at once.
        """
        return self._sift(collect(self, deadline_ns, wanted))

    def drain_now(self) -> Rows:
        """Return what has been received. Does not block."""
        return self._sift(self.receive())

    def wait(self, deadline_ns: int) -> Rows:
        """Return as soon as anything has come, or at the deadline with nothing."""
        while True:
            raw = collect(self, deadline_ns)
            received = self._sift(raw)
            if len(received) or not len(raw) or self.clock.now() >= deadline_ns:
                return received

    def _sift(self, received: Rows) -> Rows:
        """Count error frames and keep the rest."""
        if max(received["flags"].tolist(), default=0) < ERROR:  # sooner known than of each
            return received
        frames: Rows = received[received["flags"] & ERROR == 0]
        self._errors += len(received) - len(frames)
        return frames

    def events(self) -> BusEvents:
        """Return error frames and losses since the last call, and which buses are off.

        Where one has just gone off, what waits to be sent is dropped as far as the interface lets it.
        """
        overflow = sum(link.overflow for link in self._links)
        self._states = [link.worst_state() for link in self._links]
        off = self._off_bits()
        gone = off & ~self._was_off
        for bus, link in enumerate(self._links):
            if gone >> bus & 1:
                link.died()
        self._was_off = off
        events = BusEvents(self._errors, off, overflow - self._overflow_seen, max(self._states))
        self._errors = 0
        self._overflow_seen = overflow
        return events

    def _off_bits(self) -> int:
        """As `BusEvents.off`, with the states that the last `events` has found."""
        bits = 0
        for bus, link in enumerate(self._links):
            bits |= (self._dead[bus] or link.off or self._states[bus] is BusState.OFF) << bus
        return bits

    def skew_ns(self) -> int:
        """Return the time between the first frames of the last `send` on the buses; 0 of a single bus.

        Each as in `sent_ns`; a bus that took none does not count.
        """
        if len(self._links) == 1:
            return 0
        first = [times[0] for link in self._links if (times := link.sent_ns())]
        return max(first, default=0) - min(first, default=0)

    def sent_ns(self) -> Sequence[int | None]:
        """Return when each frame of the last `send` ended on its wire, where the interface knows it.

        Else when the interface had taken it; None for what was not taken.
        """
        own = [iter(link.sent_ns()) for link in self._links]
        return [next(own[bus], None) for bus in self._order]

    def flush_tx(self) -> None:
        """Drop frames that still wait to be sent, and have a dead bus another try.

        Raises BusError when an interface cannot, or is not the configured one any more; all are tried.
        """
        failed: BusError | None = None
        for link in self._links:
            try:
                link.flush_tx()
            except BusError as error:
                failed = failed or error
        if failed is not None:
            raise failed

    def close(self) -> None:
        """Leave the bus and give the role back."""
        with ExitStack() as opened:
            if self._role is not None:
                opened.callback(self._role.close)
            for link in self._links[::-1]:
                opened.callback(link.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _open(settings: BusSettings, clock: BenchClock | None) -> Link:
    """Open one interface; clock: that of another localcan channel, which this one is to go by."""
    interface = settings.interface
    options: dict[str, Any] = settings.options
    known = {"localcan": ("spin_us", "tx_limit"), "socketcan": (RESTART_MS,)}.get(interface)
    if known is None:
        return open_python_can(settings)
    if unknown := sorted(set(options) - set(known)):
        allowed = ", ".join(known)
        raise BusError(f"bus.options: {', '.join(unknown)} unknown for {interface}; allowed: {allowed}")
    if interface == "socketcan":
        return SocketCan(settings)
    for key, value in options.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 10_000:
            raise BusError(f"bus.options.{key}: a number from 0 to 10000 is allowed, not {value!r}")
    timing, fd = BitTiming.of(settings), settings.layout == "fd"
    return Participant(settings.channel, timing, fd=fd, clock=clock, **options)
