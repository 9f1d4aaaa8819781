"""Links and a clock without a bus, controlled by a test."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet

from drivers.arrays import Rows
from drivers.can.link import Link
from drivers.clock import Clock
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import BusState


class ManualClock(Clock):
    """A clock that a test sets and a sleep advances. State: the time, and the ends of all sleeps."""

    def __init__(self) -> None:
        self.t_ns, self.slept = 1_000, list[int]()

    def now(self) -> int:
        return self.t_ns

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        del spin_ns
        self.slept.append(t_ns)
        self.t_ns = max(self.t_ns, t_ns)


class FakeLink(Link):
    """A link that accepts `takes` frames at once and receives one list per poll; a wait takes 1 ms.

    State: frames sent, waits and calls.
    """

    off, overflow, knows_ends, virtual = False, 0, True, True

    def __init__(self, clock: Clock, *looks: list[Received], ends_ns: Sequence[int] = (7, 8)) -> None:
        self.clock, self.takes, self.looks, self.ends_ns = clock, 64, list(looks), ends_ns
        self.state, self.end_ns, self.file = BusState.UNKNOWN, -1, -1
        self.sent, self.calls = list[Frame](), list[str]()
        self.blocked = list[tuple[int, set[int]]]()
        self.fails: Exception | None = None

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if self.fails is not None:
            raise self.fails

    def send(self, frames: Rows) -> int:
        self._call("send")
        taken = sent_frames(frames)[: self.takes]
        self.sent += taken
        return len(taken)

    def receive(self) -> Rows:
        return received_array(self.looks.pop(0) if self.looks else [])

    def block(self, deadline_ns: int, missing: AbstractSet[int]) -> None:
        self.blocked.append((deadline_ns, set(missing)))
        if isinstance(self.clock, ManualClock):
            self.clock.t_ns += 1_000_000

    def worst_state(self) -> BusState:
        return self.state

    def foresee(self) -> int | None:
        return None if self.end_ns < 0 else self.end_ns

    def fileno(self) -> int:
        return self.file

    def died(self) -> None:
        self._call("died")

    def flush_tx(self) -> None:
        self._call("flush")

    def sent_ns(self) -> Sequence[int]:
        return self.ends_ns

    def close(self) -> None:
        self._call("close")


def links(count: int) -> list[FakeLink]:
    clock = ManualClock()
    return [FakeLink(clock) for _ in range(count)]
