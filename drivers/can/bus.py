"""Bus: the door to the CAN bus, whatever interface is behind it.

Frames go out and come in as they are, elements of FRAME; what they mean is the protocol's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from typing import NamedTuple, Self

from drivers.arrays import Rows
from drivers.can.bus_time import BitTiming
from drivers.can.can_interface import RESTART_MS
from drivers.can.collect import collect
from drivers.can.link_group import DEAD_AFTER_NS, Link, LinkGroup
from drivers.can.localcan.bench_clock import BenchClock
from drivers.can.localcan.participant import Participant
from drivers.can.python_can import open_python_can
from drivers.can.runtime_folder import RoleLock
from drivers.can.socketcan import SocketCan
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.protocol import ERROR
from drivers.signals import BusState

EXCLUSIVE_ROLES = frozenset({"controller", "plant"})
"""At most one of each on a channel of this machine; on one of localcan, in its runtime folder."""


class BusEvents(NamedTuple):
    """What happened on the bus beside frames since the last call."""

    errors: int
    """Error frames."""
    off: int
    """Bit i: bus i is off or down as of now, or was bus-off since the last call.

    Every bit where none has taken a frame for `DEAD_AFTER_NS`.
    """
    overflow: int
    """Received frames that were lost because they were not read in time."""
    state: BusState = BusState.UNKNOWN
    """The worst state of the CAN controller since the last call."""


class Bus:
    """An open bus, or several as one: then each frame says by its flags on which it is.

    `clock` is that of its frames' times and of all deadlines.

    Mutable state: the link, the error count since the last `events`, which buses were off then, and since
    when it refuses frames.
    """

    def __init__(self, link: Link | LinkGroup, role: RoleLock | ExitStack | None = None) -> None:
        self._link = link
        self.clock = link.clock
        self._role = role
        self._errors = 0
        self._overflow_seen = 0
        self._refused_since = 0
        self._dead = False
        self._was_off = 0

    @property
    def facts(self) -> str:
        """What was read of the interface, in one line; empty where there is nothing to read."""
        return self._link.facts

    @classmethod
    def open(cls, settings: BusSettings, role: str) -> Bus:
        """Open the bus of the configuration.

        role: `controller` and `plant` are exclusive on a channel of this machine, any other name is not.
        Several `localcan` channels go by the clock of the first.
        Raises RunError when another process has the role, BusError when the bus cannot be opened.
        """
        if settings.layout == "ideal":
            raise BusError("bus.layout: ideal takes no bus time and is for hil sim only; use classic or fd")
        links: list[Link] = []
        with ExitStack() as roles, ExitStack() as opened:
            clock: BenchClock | None = None
            for each in settings.buses:
                if role in EXCLUSIVE_ROLES:
                    roles.callback(RoleLock(each.interface, each.channel, role).close)
                if each.interface == "localcan":
                    participant = _open_localcan(each, clock)
                    clock = participant.clock
                    links.append(participant)
                else:
                    links.append(_LINKS.get(each.interface, open_python_can)(each))
                opened.callback(links[-1].close)
            opened.pop_all()
            return cls(links[0] if len(links) == 1 else LinkGroup(links), roles.pop_all())

    def send(self, frames: Rows) -> int:
        """Send frames and return the number of those that the bus did not take.

        A refusal that passes is a busy bus; one that lasts makes `events().off`. Does not wait for
        the bus, and raises only for frames that it cannot carry at all (BusError).
        """
        if not len(frames):
            return 0
        taken = self._link.send(frames)
        if taken:
            self._refused_since = 0
            self._dead = False
        else:
            now = self.clock.now()
            self._refused_since = self._refused_since or now
            self._dead = now - self._refused_since >= DEAD_AFTER_NS
        return len(frames) - taken

    def drain(self, deadline_ns: int, wanted: AbstractSet[int]) -> Rows:
        """Return all frames in the order received, as soon as one of every wanted identifier has come.

        Returns at the deadline with what is there. What came before the call counts: to wait for answers,
        `drain_now` before asking. An empty `wanted` is fulfilled at once.
        """
        return self._sift(collect(self._link, deadline_ns, wanted))

    def drain_now(self) -> Rows:
        """Return what has been received. Does not block."""
        return self._sift(self._link.receive())

    def wait(self, deadline_ns: int) -> Rows:
        """Return as soon as anything has come, or at the deadline with nothing."""
        while True:
            raw = collect(self._link, deadline_ns)
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
        overflow, state = self._link.overflow, self._link.worst_state()
        group = self._link if isinstance(self._link, LinkGroup) else None
        off = int(self._link.off or state is BusState.OFF) if group is None else group.off_bits
        if self._dead:
            off = 1 if group is None else group.every_bit
        gone = off & ~self._was_off
        if isinstance(self._link, LinkGroup):
            self._link.died(gone)
        elif gone:
            self._link.died()
        self._was_off = off
        events = BusEvents(self._errors, off, overflow - self._overflow_seen, state)
        self._errors = 0
        self._overflow_seen = overflow
        return events

    @property
    def knows_ends(self) -> bool:
        """Whether `sent_ns` says when frames ended on the wire."""
        return self._link.knows_ends

    @property
    def virtual(self) -> bool:
        """Whether frames are there as soon as they are sent: no wire takes its time."""
        return self._link.virtual

    def skew_ns(self) -> int:
        """Return the time between the first frames of the last `send` on the buses; 0 of a single bus."""
        return self._link.skew_ns() if isinstance(self._link, LinkGroup) else 0

    def sent_ns(self) -> Sequence[int | None]:
        """Return when each frame of the last `send` ended on the wire, where the interface knows it.

        Else when the interface had taken it; None, or no more entries, for what was not taken.
        """
        return self._link.sent_ns()

    def flush_tx(self) -> None:
        """Drop frames that still wait to be sent, and have a dead bus another try.

        Raises BusError when the interface cannot, or is not the configured one any more.
        """
        self._link.flush_tx()

    def close(self) -> None:
        """Leave the bus and give the role back."""
        try:
            self._link.close()
        finally:
            if self._role is not None:
                self._role.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _open_localcan(settings: BusSettings, clock: BenchClock | None = None) -> Participant:
    spin_us = _number(settings, "spin_us", 50.0)
    tx_limit = int(_number(settings, "tx_limit", 64))
    _refuse_options(settings, {"spin_us", "tx_limit"})
    fd = settings.layout == "fd"
    return Participant(
        settings.channel, BitTiming.of(settings), fd=fd, spin_us=spin_us, tx_limit=tx_limit, clock=clock
    )


def _open_socketcan(settings: BusSettings) -> Link:
    _refuse_options(settings, {RESTART_MS})
    return SocketCan(settings)


def _refuse_virtual(settings: BusSettings) -> Link:
    raise BusError(
        f"bus.interface: virtual ({settings.channel}) lives inside one process, "
        "and controller and drives are two; use localcan, or hil sim for both in one process"
    )


def _number(settings: BusSettings, key: str, default: float) -> float:
    value = settings.options.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 10_000:
        raise BusError(f"bus.options.{key}: a number from 0 to 10000 is allowed, not {value!r}")
    return float(value)


def _refuse_options(settings: BusSettings, known: set[str]) -> None:
    unknown = sorted(set(settings.options) - known)
    if unknown:
        allowed = ", ".join(sorted(known)) or "none"
        raise BusError(
            f"bus.options: {', '.join(unknown)} unknown for {settings.interface}; allowed: {allowed}"
        )


_LINKS: dict[str, Callable[[BusSettings], Link]] = {
    "socketcan": _open_socketcan,
    "virtual": _refuse_virtual,
}
