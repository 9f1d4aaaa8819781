"""The CAN bus as the other packages see it, independent of the interface.

Frames pass unchanged, as FRAME records; the protocol interprets them.
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
from drivers.can.hardware_stamps import HARDWARE_STAMPS
from drivers.can.link import Link, Source, collect
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.participant import LOOK_S, Participant
from drivers.can.python_can import open_python_can
from drivers.can.runtime_folder import RoleLock
from drivers.can.socketcan import SocketCan
from drivers.can.udp import Udp
from drivers.clock import MONOTONIC
from drivers.config import UDP, BusSettings
from drivers.errors import BusError
from drivers.frame_array import joined
from drivers.protocol import ERROR
from drivers.signals import BusState

DEAD_AFTER_NS = 50_000_000
"""A bus that accepts no frame for this long counts as dead; before that it is busy."""
_POLL_NS = 200_000
"""Pause between two polls where one of several links has no descriptor to wait on."""


class BusEvents(NamedTuple):
    """Error frames, lost frames and controller states of the CAN bus since the last call of `Bus.events`."""

    errors: int
    """Number of error frames."""
    off: int
    """Bit i is set if bus i is off or down now, has accepted no frame for `DEAD_AFTER_NS`, or was bus-off
    since the last call."""
    overflow: int
    """Received frames lost because they were not read in time."""
    state: BusState = BusState.UNKNOWN
    """Worst state of the CAN controller since the last call."""


class Bus(Source):
    """One open CAN bus, or several that act as one; each frame carries the index of its bus.

    `clock`: clock of frame times and deadlines: that of the interfaces if they share one, else
    CLOCK_MONOTONIC. `knows_ends`: True if `sent_ns` gives the end of each frame on the wire. `virtual`: True
    if on some bus frames arrive as soon as they are sent, without bus time.

    Mutable state: the interfaces, in bus order; error counts, bus-off flags and worst controller states at
    the last call of `events`; for each bus since when it refuses frames and whether it counts as dead; the
    bus on which each identifier was last received; the bus of each frame of the last `send`.
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
        """Settings and controller states read from the interfaces, one line of text; empty if unknown."""
        return "; ".join(link.facts for link in self._links if link.facts)

    @classmethod
    def open(cls, settings: BusSettings, role: str) -> Bus:
        """Open all configured buses.

        role: `controller` or `plant`; only one process of this machine holds a role on a channel (on
        localcan: one process per runtime folder). All `localcan` and `udp` channels share the clock of the
        first `localcan` one.
        Raises RunError if another process holds the role, BusError if a bus cannot be opened.
        """
        links: list[Link] = []
        with ExitStack() as roles, ExitStack() as opened:
            clock: BenchClock | None = None
            for each in settings.buses:
                roles.callback(RoleLock(each.interface, each.channel, role).close)
                link = Udp(each, role) if each.interface == UDP else _open(each, clock)
                opened.callback(link.close)
                links.append(link)
                clock = link.clock if isinstance(link, Participant) else clock
            for link in links:
                if isinstance(link, Udp):
                    link.clock = clock or MONOTONIC
            opened.pop_all()
            return cls(links, roles.pop_all())

    def send(self, frames: Rows) -> int:
        """Send each frame on its bus; the result is the number of frames that were not accepted.

        Each bus accepts its first frames, up to the first refusal. A brief refusal means a busy bus; a
        lasting one sets the bus's bit in `events().off`. Never waits. Raises BusError for a frame that its
        bus cannot carry, but only after all other buses have their frames, which may be an emergency stop.
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
            except Exception as error:  # noqa: BLE001 - raised after all buses have their frames
                failed = failed or error
            taken += took
            now = self.clock.now()
            self._refused_since[bus] = since = 0 if took else self._refused_since[bus] or now
            self._dead[bus] = not took and now - since >= DEAD_AFTER_NS
        if failed is not None:
            raise failed
        return len(frames) - taken

    def receive(self) -> Rows:
        """FRAME records received on all buses since the last call, with error frames, in time order."""
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
        """Sleep until more frames may have arrived, at most until the deadline (time of `clock`, ns).

        missing: identifiers still awaited, each on the bus that last delivered it, one bus after the other.
        If that bus is unknown, or if `missing` is empty (any frame counts), the call waits for all buses
        together.
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
            clock.sleep_until(min(deadline_ns, clock.now() + _POLL_NS))
            return
        clock.waiting(deadline_ns)
        quiet = [link.arm() for link in self._links]
        left_s = (deadline_ns - clock.now()) * 1e-9
        if all(quiet) and left_s > 0:
            stands = self._off_bits() != 0 or clock.stands()
            select.select(files, [], [], min(left_s, LOOK_S) if stands else left_s)
        clock.working()

    def drain(self, deadline_ns: int, wanted: AbstractSet[int]) -> Rows:
        """Receive until every identifier of `wanted` has arrived; returns all frames in order of reception.

        At `deadline_ns` the result is the frames received so far. Frames that arrived before the call count:
        to wait for answers, call `drain_now` before the request. With an empty `wanted` the call does not
        wait.
        """
        return self._sift(collect(self, deadline_ns, wanted))

    def drain_now(self) -> Rows:
        """Frames received since the last call, FRAME records; does not wait."""
        return self._sift(self.receive())

    def wait(self, deadline_ns: int) -> Rows:
        """Wait for frames until `deadline_ns`; the result has all that have arrived, none after a timeout."""
        while True:
            raw = collect(self, deadline_ns)
            received = self._sift(raw)
            if len(received) or not len(raw) or self.clock.now() >= deadline_ns:
                return received

    def _sift(self, received: Rows) -> Rows:
        if max(received["flags"].tolist(), default=0) < ERROR:  # faster than a mask for each frame
            return received
        frames: Rows = received[received["flags"] & ERROR == 0]
        self._errors += len(received) - len(frames)
        return frames

    def events(self) -> BusEvents:
        """Error frames and losses since the last call, controller state, and the buses that are off.

        When a bus goes off, its waiting frames are dropped as far as the interface allows.
        """
        overflow = sum(link.overflow for link in self._links)
        self._states = [link.worst_state() for link in self._links]
        off = self._off_bits()
        went_off = off & ~self._was_off
        for bus, link in enumerate(self._links):
            if went_off >> bus & 1:
                link.died()
        self._was_off = off
        events = BusEvents(self._errors, off, overflow - self._overflow_seen, max(self._states))
        self._errors = 0
        self._overflow_seen = overflow
        return events

    def _off_bits(self) -> int:
        bits = 0
        for bus, link in enumerate(self._links):
            bits |= (self._dead[bus] or link.off or self._states[bus] is BusState.OFF) << bus
        return bits

    def skew_ns(self) -> int:
        """Time between the first frames of the last `send` on the earliest and the latest bus, ns.

        Times are those of `sent_ns`; a bus that had or accepted no frame does not count. 0 on a single bus.
        """
        if len(self._links) == 1:
            return 0
        asked = [link for bus, link in enumerate(self._links) if bus in self._order or not self._order]
        first = [times[0] for link in asked if (times := link.sent_ns())]
        return max(first, default=0) - min(first, default=0)

    def sent_ns(self) -> Sequence[int | None]:
        """For each frame of the last `send`, the end of its transmission on the wire, ns; None if refused.

        On an interface that does not report ends, the time at which the interface accepted the frame.
        """
        own = [iter(link.sent_ns()) for link in self._links]
        return [next(own[bus], None) for bus in self._order]

    def flush_tx(self) -> None:
        """Drop frames that still wait to be sent, and restart bus-off controllers where that is possible.

        Raises BusError, after all interfaces were tried, if one cannot drop its frames or its settings differ
        from the configuration.
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
        """Close all interfaces and release this process's role on their channels."""
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
    interface = settings.interface
    options: dict[str, Any] = settings.options
    known = {"localcan": ("spin_us",), "socketcan": (RESTART_MS, HARDWARE_STAMPS)}.get(interface)
    if known is None:
        return open_python_can(settings)
    if unknown := sorted(set(options) - set(known)):
        allowed = ", ".join(known)
        raise BusError(f"bus.options: {', '.join(unknown)} unknown for {interface}; allowed: {allowed}")
    if not isinstance(options.get(HARDWARE_STAMPS, False), bool):
        raise BusError(f"bus.options.{HARDWARE_STAMPS}: true or false is allowed")
    if interface == "socketcan":
        return SocketCan(settings)
    for key, value in options.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 10_000:
            raise BusError(f"bus.options.{key}: a number from 0 to 10000 is allowed, not {value!r}")
    timing, fd = BitTiming.of(settings), settings.layout == "fd"
    return Participant(settings.channel, timing, fd=fd, clock=clock, **options)
