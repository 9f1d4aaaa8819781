"""SharedBus: CAN FMUs on one simulated bus in lockstep, with bit time, arbitration, errors and confirmation.

Deterministic: it reads no clock. A frame lasts as long as on localcan (`drivers.can.bus_time`, longest frame,
interframe space included) and is delivered at its end.
"""

from collections.abc import Callable, Sequence
from itertools import count
from typing import NamedTuple

from drivers.can.arbitration import priority
from drivers.can.bus_time import ERROR_FRAME_BITS, INTERFRAME, BitTiming, frame_time_ns
from drivers.protocol import Frame
from plant_fmu.network import operations as op
from plant_fmu.network.node import Node
from plant_fmu.network.operations import Code, Operation
from plant_fmu.network.station import Station, Stations

_CRC_ERROR = 4
_PRIMARY, _SECONDARY = 1, 2


class _Waiting(NamedTuple):
    """A frame that waits for the bus. The smallest one wins, error-active nodes first."""

    rank: int
    number: int
    station: int
    operation: Operation


class SharedBus:
    """Bus of `nodes` from time 0.

    timing: bit rates where no node configures them. step_ns: longest communication step of a node, and the
    grid of triggered Tx clocks. error_every: destroy each N-th frame with a CRC error; 0: none. on_frame:
    called with the end, ns, the node's index and the frame.

    Mutable state: the stations; the frames that wait and the one on the wire; the time; counts.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        timing: BitTiming,
        step_ns: int,
        *,
        error_every: int = 0,
        on_frame: Callable[[int, int, Frame], None] = lambda *_: None,
    ) -> None:
        self.stations = Stations(map(Station, nodes))
        self.now_ns = self.busy_ns = self.frames = self.destroyed = self.lost = 0
        self._timing, self._step_ns = timing, step_ns
        self._error_every, self.on_frame = error_every, on_frame
        self._waiting: list[_Waiting] = []
        self._on_wire: tuple[int, _Waiting] | None = None
        self._numbers = count()

    def run(self, until_ns: int) -> None:
        """Simulate until `until_ns`, ns. Raises PlantError if an FMU fails or does not settle."""
        while True:
            for index, operation in self.stations.go(self.now_ns, self._step_ns):
                frame = op.to_frame(operation)
                rank = priority(frame.id, frame.flags)
                self._waiting.append(_Waiting(rank, next(self._numbers), index, operation))
            if self._on_wire is None:
                self._start()
            if self.now_ns >= until_ns:
                return
            ends = [] if self._on_wire is None else [self._on_wire[0]]
            self.now_ns = min([until_ns, self.stations.next_ns(self.now_ns, self._step_ns), *ends])
            if self._on_wire is not None and self._on_wire[0] <= self.now_ns:
                self._finish(self._on_wire[1])

    @property
    def _destroys(self) -> bool:
        """True if the frame on the wire, or the next one, is to be destroyed."""
        return self._error_every > 0 and (self.frames + self.destroyed + 1) % self._error_every == 0

    def _start(self) -> None:
        """Put the frame that wins arbitration on the wire; drop those of nodes that are bus-off."""
        status = [station.status for station in self.stations]
        self._waiting = [each for each in self._waiting if status[each.station] != op.BUS_OFF]
        if not self._waiting:
            return
        first = min(self._waiting, key=lambda each: (status[each.station], each))
        self._waiting.remove(first)
        frame, timing = op.to_frame(first.operation), self.stations.bit_rates(self._timing)
        duration = frame_time_ns(len(frame.data), frame.flags, timing)
        if self._destroys:
            duration += -(-(ERROR_FRAME_BITS - INTERFRAME) * 1_000_000_000 // timing.bitrate)
        self.busy_ns += duration
        self._on_wire = self.now_ns + duration, first

    def _finish(self, sent: _Waiting) -> None:
        self._on_wire = None
        identifier = sent.operation.arguments[0]
        others = [s for k, s in enumerate(self.stations) if k != sent.station and s.status != op.BUS_OFF]
        sender = self.stations[sent.station]
        if self._destroys:
            self.destroyed += 1
            for place, station in enumerate([*others, sender]):
                flag = _SECONDARY if place else _PRIMARY
                arguments = identifier, _CRC_ERROR, flag, int(station is sender)
                station.inbox.append(Operation(Code.BUS_ERROR, arguments))
        else:
            self.frames += 1
            for station in others:
                station.inbox.append(sent.operation)
            if others:
                sender.inbox.append(Operation(Code.CONFIRM, (identifier,)))
            self.on_frame(self.now_ns, sent.station, op.to_frame(sent.operation))
        for waiting in sorted(self._waiting):
            station = self.stations[waiting.station]
            if station.discards:
                self.lost += 1
                self._waiting.remove(waiting)
                lost = waiting.operation.arguments[0]
                station.inbox.append(Operation(Code.ARBITRATION_LOST, (lost,)))
