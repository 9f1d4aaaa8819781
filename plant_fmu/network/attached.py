"""Attached: CAN FMUs on a CAN interface in real time, each with a link of its own.

Arbitration, bit time and errors are those of the interface. The FMUs are stepped in communication steps. A
frame or a countdown between two steps is met at its own time. Late steps are made up for: none is left out.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from drivers.can.arbitration import priority
from drivers.can.bus import Bus
from drivers.can.link import OWN, Link
from drivers.errors import BusError
from drivers.frame_array import sent_array, unpack_frames
from drivers.protocol import ERROR, FD, Frame
from plant_fmu.network import operations as op
from plant_fmu.network.operations import Code, Operation
from plant_fmu.network.station import Stations

_BINS_US = 100_000
"""Lateness is counted in bins of 1 us up to this; the last bin has all beyond."""


class Attached:
    """CAN FMUs of `stations`, in real time on `links`, one link each with the same clock.

    Mutable state: the stations and links; per station the frames that the interface has not confirmed; the
    histogram of lateness; counts.
    """

    def __init__(self, stations: Stations, links: Sequence[Link], step_ns: int) -> None:
        self.stations, self._links, self._step_ns = stations, list(links), step_ns
        self.frames = self.lost = self.errors = self.unsent = 0
        self._pending: list[list[Frame]] = [[] for _ in self.stations]
        self._late = np.zeros(_BINS_US + 1, np.int64)

    def run(self, until_ns: int) -> None:
        """Run from time 0 to `until_ns`, ns. Raises PlantError, BusError."""
        bus, clock = Bus(self._links), self._links[0].clock
        begin_ns, now = clock.now(), 0
        while True:
            for index in range(len(self.stations)):
                self._receive(index)
            self.send(self.stations.go(now, self._step_ns))
            if now >= until_ns:
                return
            due = min(until_ns, self.stations.next_ns(now, self._step_ns))
            if begin_ns + due > clock.now():
                bus.block(begin_ns + due, frozenset())
            reached = clock.now() - begin_ns
            if reached >= due:
                self._late[min((reached - due) // 1000, _BINS_US)] += 1
            now = min(due, max(now, reached))

    def lateness(self) -> dict[str, int]:
        """Median, 99 % and largest lateness of the steps, us; `largest` is bounded by 0.1 s."""
        counts = np.cumsum(self._late)
        if not counts[-1]:
            return {}
        places = {"median_us": 0.5, "p99_us": 0.99, "largest_us": 1.0}
        return {name: int(np.searchsorted(counts, part * counts[-1])) for name, part in places.items()}

    def send(self, operations: Iterable[tuple[int, Operation]]) -> None:
        """Send the frames of Transmit operations, each with the index of its station."""
        for index, operation in operations:
            link, frame = self._links[index], op.to_frame(operation)
            try:
                taken = link.send(sent_array([frame]))
            except BusError:
                self.stations[index].refuse(op.encode([operation]))
                continue
            self.frames += taken
            self.unsent += not taken
            if taken and link.knows_ends:
                self._pending[index].append(frame)
            elif taken:
                self._confirm(index, frame)

    def _confirm(self, index: int, frame: Frame) -> None:
        self.stations[index].inbox.append(Operation(Code.CONFIRM, (frame.id,)))

    def _receive(self, index: int) -> None:
        station, pending, foreign = self.stations[index], self._pending[index], False
        for _, identifier, _, size, flags, data in unpack_frames(self._links[index].receive().tobytes()):
            frame = Frame(identifier, data[:size], flags & (ERROR - 1))
            if flags & ERROR:
                self.errors += 1
            elif flags & OWN:
                self._confirm(index, frame)
                own = next((k for k, each in enumerate(pending) if _same(each, frame)), None)
                if own is not None:
                    del pending[own]
            elif station.status != op.BUS_OFF:
                foreign = True
                station.inbox.append(op.from_frame(frame))
        if foreign and pending and station.discards:
            self._discard(index)

    def _discard(self, index: int) -> None:
        """Take back the frames that have not started, as another node's frame was first."""
        withdrawn: Any = self._links[index].flush_tx()  # localcan: a number
        pending = sorted(self._pending[index], key=lambda frame: priority(frame.id, frame.flags))
        stays = len(pending) - withdrawn  # only the first of these can have started
        for frame in pending[stays:]:
            self.lost += 1
            self.stations[index].inbox.append(Operation(Code.ARBITRATION_LOST, (frame.id,)))
        self._pending[index] = pending[:stays]


def _same(sent: Frame, heard: Frame) -> bool:
    """True if `heard` is `sent` with the flag OWN, perhaps padded."""
    size = len(sent.data)
    return sent.id == heard.id and sent.data == heard.data[:size] and (sent.flags ^ heard.flags) & FD == 0
