"""Both ends of several buses in one process: each bus has its own arbitration and bit time."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from drivers.can.arbitration import priority, transmit
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.protocol import ALWAYS, BUS, Frame, Received
from hil.app.sim.lockstep import Burst, Lockstep, Shape

_TIME = itemgetter(0)
_Waiting = tuple[int, int, int, int, bool, Frame]
"""See `drivers.can.arbitration.transmit`, then whether a drive sends it, and the frame."""


@dataclass
class SeveralWires(Lockstep):
    """As `Lockstep`, with a wire for each bus.

    Mutable state, beside that of `Lockstep`: what waits for each wire, and when each falls free.
    """

    timings: tuple[BitTiming, ...] = ()
    """Of each bus; not used where `timing` is None, which is layout ideal."""
    _waiting: list[list[_Waiting]] = field(default_factory=list)
    _free: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._waiting = [[] for _ in self.timings]
        self._free = [ALWAYS] * self.buses
        super().__post_init__()

    def _open(self, t_ns: int, opening: tuple[Frame, ...], deadline: int) -> None:
        """Let what starts the tick reach the drives, each bus by itself; take note of how far apart."""
        before = len(self._commands)
        self._carry(self._give(t_ns, opening))
        for bus, waiting in enumerate(self._waiting):
            while self._free[bus] <= deadline and any(each[-1] in opening for each in waiting):
                self._carry(self._free[bus])
                waiting = self._waiting[bus]  # noqa: PLW2901 - what is left
        self._note_sent(opening, self._commands[before:])
        ends: dict[int, int] = {}
        for frame, t_end_ns in zip(opening, self.sent_ns, strict=True):
            if t_end_ns is not None:
                ends[frame.bus] = min(ends.get(frame.bus, t_end_ns), t_end_ns)
        self._commands.sort(key=_TIME)
        self.skew_ns = max(ends.values()) - min(ends.values()) if len(ends) == self.buses else 0

    def _give(self, t_ns: int, opening: tuple[Frame, ...]) -> int:
        """Put what starts the tick into the queues of its buses; return when the last one had it."""
        self._queue([(t_ns, frame) for frame in opening], from_drive=False)
        return t_ns

    def _send(
        self, t_ns: int, frames: Sequence[Frame], end_ns: int, receiver: list[Received]
    ) -> Burst | None:
        """Return None: frames of several buses are queued one by one."""
        del t_ns, frames, end_ns, receiver
        return None

    def _wire(self, shape: Shape) -> tuple[int, int]:
        """Return the priority of a frame and its ns on the wire of its bus."""
        wire = self._shapes.get(shape)
        if wire is None:
            identifier, length, flags = shape
            bus, own = divmod(flags, BUS)
            duration = 0 if self.timing is None else frame_time_ns(length, own, self.timings[bus])
            wire = self._shapes[shape] = priority(identifier, own), duration
        return wire

    def _queue(self, sends: Iterable[tuple[int, Frame]], *, from_drive: bool) -> None:
        """Put frames into their nodes' transmit queues, each at its instant and on its bus."""
        for t_ns, frame in sends:
            identifier, data, flags = frame
            rank, duration = self._wire((identifier, len(data), flags))
            self._number += 1
            self._waiting[flags // BUS].append((t_ns, rank, self._number, duration, from_drive, frame))

    def _carry(self, until_ns: int) -> None:
        """Move every frame that starts by `until_ns` to its receiver's list."""
        ended: list[tuple[int, _Waiting]] = []
        for bus, waiting in enumerate(self._waiting):
            if waiting:
                sent, self._waiting[bus], self._free[bus] = transmit(waiting, self._free[bus], until_ns)
                ended += sent
        ended.sort(key=_TIME)
        for end_ns, (*_, from_drive, frame) in ended:
            (self._late if from_drive else self._commands).append(Received(end_ns, frame))
