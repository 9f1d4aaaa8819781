"""Several buses behind one door: frames carry the index of their bus."""

from __future__ import annotations

import select
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from typing import Protocol

import numpy as np

from drivers.arrays import Rows
from drivers.can.collect import Source
from drivers.can.localcan.bench_clock import BenchClock
from drivers.clock import MONOTONIC, Clock
from drivers.errors import BusError
from drivers.frame_array import joined
from drivers.signals import BusState

DEAD_AFTER_NS = 50_000_000
"""A bus that takes no frame at all for this long is dead; for less, it is busy."""
_FIRST_LOOK_NS = 200_000
"""Between two looks at a link that cannot be waited for together with others."""
_LOOK_S = 1e-3
"""Between two looks while time stands still, or a bus is off."""


class Link(Source, Protocol):
    """One interface behind a Bus. Received frames may be error frames."""

    @property
    def facts(self) -> str:
        """What was read of the interface, in one line; empty where there is nothing to read."""

    @property
    def knows_ends(self) -> bool:
        """The interface knows when a frame ended on the wire."""

    @property
    def virtual(self) -> bool:
        """Frames are there as soon as they are sent."""

    @property
    def off(self) -> bool:
        """The interface says that the bus is off or down."""

    @property
    def overflow(self) -> int:
        """Frames lost so far."""

    def send(self, frames: Rows) -> int:
        """Return how many elements of FRAME were taken, from the first on; their bus is 0."""

    def first_sent_ns(self) -> int | None:
        """Return when the first frame of the last `send` ended on the wire; None where that is not known."""

    def sent_ns(self) -> Sequence[int]:
        """Return when each frame that the last `send` took ended on the wire, else when it was taken."""

    def fileno(self) -> int:
        """Return a descriptor that is readable when something has come; -1 where there is none."""

    def foresee(self) -> int | None:
        """Return when the next foreign frame that is under way will have ended; None where none is known."""

    def arm(self, *, idle: bool = True) -> bool:
        """Ask for a word by `fileno`, unless something has come; return whether nothing has."""

    def worst_state(self) -> BusState:
        """Return the worst state of the controller since the last call."""

    def died(self) -> None:
        """Take note that the bus has died: frames that wait to be sent are stale."""

    def flush_tx(self) -> object:
        """Drop frames that wait to be sent."""

    def close(self) -> None:
        """Free the interface."""


class LinkGroup:
    """The links of several buses as one.

    Mutable state: the links; on which of them each identifier was last received; on which each frame of the
    last `send` went; when each had taken what that gave it, and since when it takes none; the worst state of
    each at the last look.
    """

    def __init__(self, links: Sequence[Link]) -> None:
        """Take the links in the order of their buses."""
        self._links = tuple(links)
        clocks = {id(link.clock) for link in self._links}
        self.clock: Clock = self._links[0].clock if len(clocks) == 1 else MONOTONIC
        self._home: dict[int, int] = {}
        self._order: list[int] = []
        self._taken_ns = [0] * len(self._links)
        self._refused_since = [0] * len(self._links)
        self._states = [BusState.UNKNOWN] * len(self._links)

    @property
    def facts(self) -> str:
        """What was read of the interfaces; empty where there is nothing to read."""
        return "; ".join(link.facts for link in self._links if link.facts)

    @property
    def knows_ends(self) -> bool:
        """Whether each bus knows when a frame ended on its wire."""
        return all(link.knows_ends for link in self._links)

    @property
    def virtual(self) -> bool:
        """Whether frames of a bus are there as soon as they are sent."""
        return any(link.virtual for link in self._links)

    @property
    def off_bits(self) -> int:
        """Bit i is set while bus i is off or down, or was bus-off before the last `worst_state`."""
        return sum(1 << bus for bus in range(len(self._links)) if self._is_off(bus))

    def _is_off(self, bus: int) -> bool:
        since = self._refused_since[bus]
        dead = since != 0 and self.clock.now() - since >= DEAD_AFTER_NS
        return dead or self._links[bus].off or self._states[bus] is BusState.OFF

    def worst_state(self) -> BusState:
        """Return the worst state of all controllers since the last call."""
        self._states = [link.worst_state() for link in self._links]
        return max(self._states)

    def died(self, bits: int) -> None:
        """Take note that buses have died: bus i where bit i is set."""
        for bus, link in enumerate(self._links):
            if bits >> bus & 1:
                link.died()

    @property
    def every_bit(self) -> int:
        """The bits of all buses."""
        return (1 << len(self._links)) - 1

    @property
    def off(self) -> bool:
        """Whether a bus is off or down."""
        return self.off_bits != 0

    @property
    def overflow(self) -> int:
        """Frames lost so far, on all buses."""
        return sum(link.overflow for link in self._links)

    def send(self, frames: Rows) -> int:
        """Return how many frames the buses took, each bus from its first on."""
        self._order = frames["bus"].tolist()
        taken = 0
        for bus, link in enumerate(self._links):
            if bus in self._order:
                own = frames[frames["bus"] == bus]
                own["bus"] = 0
                took = link.send(own)
                taken += took
                self._taken_ns[bus] = now = self.clock.now()
                self._refused_since[bus] = 0 if took else self._refused_since[bus] or now
        return taken

    def skew_ns(self) -> int:
        """Return the time from the first to the last of the first frames that `send` put on the buses.

        Their ends on the wire where every link knows them, else the instants at which the interfaces had
        taken what was for them.
        """
        ends = [end for link in self._links if (end := link.first_sent_ns()) is not None]
        times = ends if len(ends) == len(self._links) else self._taken_ns
        return max(times) - min(times)

    def sent_ns(self) -> list[int | None]:
        """Return when each frame of the last `send` ended on its wire, or was taken; None: it was not."""
        own = {bus: iter(self._links[bus].sent_ns()) for bus in set(self._order)}
        return [next(own[bus], None) for bus in self._order]

    def receive(self) -> Rows:
        """Return what is there on all buses, in the order of time."""
        parts = [link.receive() for link in self._links]
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
        bench = clock if isinstance(clock, BenchClock) else None
        if bench is not None:
            bench.waiting(deadline_ns)
        quiet = [link.arm(idle=False) for link in self._links]
        left_s = (deadline_ns - clock.now()) * 1e-9
        if all(quiet) and left_s > 0:
            stands = self.off or (bench is not None and bench.stands())
            select.select(files, [], [], min(left_s, _LOOK_S) if stands else left_s)
        clock.working()

    def flush_tx(self) -> None:
        """Drop frames that wait to be sent. Raises BusError where an interface cannot."""
        failed: BusError | None = None
        for link in self._links:
            try:
                link.flush_tx()
            except BusError as error:
                failed = failed or error
        if failed is not None:
            raise failed

    def close(self) -> None:
        """Leave all buses."""
        with ExitStack() as opened:
            for link in reversed(self._links):
                opened.callback(link.close)
