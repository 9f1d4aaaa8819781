"""SharedBus: CAN FMUs on one simulated bus in lockstep, with bit time, arbitration, errors and confirmation.

Deterministic: it reads no clock. A frame lasts as long as on localcan (`drivers.can.bus_time`, longest frame,
interframe space included) and is delivered at its end.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from drivers.can.arbitration import priority
from drivers.can.bus_time import ERROR_FRAME_BITS, INTERFRAME, BitTiming, frame_time_ns
from drivers.errors import PlantError
from drivers.protocol import Frame
from plant_fmu.network import operations as op
from plant_fmu.network.node import Node
from plant_fmu.network.operations import Code, Operation
from plant_fmu.network.station import Station, bit_rates

_ROUNDS = 1000
"""Most exchanges at one instant."""
_CRC_ERROR = 4
_PRIMARY, _SECONDARY = 1, 2


class _Waiting(NamedTuple):
    """A frame that waits for the bus. The smallest tuple wins: error-active nodes first, then identifiers."""

    passive: bool
    rank: int
    number: int
    station: int
    operation: Operation


class SharedBus:
    """Bus of `nodes` from time 0.

    timing: bit rates where no node configures them. step_ns: communication step of nodes with a triggered
    Tx clock. error_every: destroy each N-th frame with a CRC error; 0: none. on_frame: called with the end,
    ns, the node's index and the frame.

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
        self.stations = [Station(node) for node in nodes]
        self.now_ns = self.busy_ns = self.frames = self.destroyed = self.lost = 0
        self._timing, self._step_ns, self._error_every, self._on_frame = (
            timing,
            step_ns,
            error_every,
            on_frame,
        )
        self._waiting: list[_Waiting] = []
        self._on_wire: tuple[int, _Waiting] | None = None
        self._number = 0
        self._stepped = any(not node.terminal.countdown for node in nodes)

    def run(self, until_ns: int) -> None:
        """Simulate until `until_ns`, ns. Raises PlantError if an FMU fails or does not settle."""
        while True:
            self._settle()
            if self._on_wire is None and self._waiting:
                self._start(min(self._waiting))
            if self.now_ns >= until_ns:
                return
            self.now_ns = self._next(until_ns)
            for station in self.stations:
                node = station.node
                if node.fmu.step_ns or not node.terminal.countdown:
                    node.advance(self.now_ns)
            if self._on_wire is not None and self._on_wire[0] <= self.now_ns:
                self._finish(self._on_wire[1])

    def _next(self, until_ns: int) -> int:
        now, times = self.now_ns, [until_ns]
        if self._stepped:
            times.append(now - now % self._step_ns + self._step_ns)
        if self._on_wire is not None:
            times.append(self._on_wire[0])
        for station in self.stations:
            node = station.node
            if step := node.fmu.step_ns:
                times.append(now - now % step + step)
            elif (due := node.next_ns()) is not None:
                times.append(max(due, now))
        return min(times)

    def _settle(self) -> None:
        for _ in range(_ROUNDS):
            busy = False
            for index, station in enumerate(self.stations):
                node = station.node
                due = node.next_ns()
                if not station.inbox and (due is None or due > self.now_ns):
                    continue
                node.advance(self.now_ns)
                if node.reached_ns == self.now_ns:
                    busy = True
                    self._accept(index, station.exchange())
            if not busy:
                return
        raise PlantError(f"the CAN FMUs answer each other without end at {self.now_ns} ns")

    def _accept(self, index: int, operations: list[Operation]) -> None:
        for operation in operations:
            if operation.code is Code.WAKEUP:
                for other, station in enumerate(self.stations):
                    if other != index:
                        station.inbox.append(operation)
                continue
            frame = op.to_frame(operation)
            passive = self.stations[index].status == op.PASSIVE
            rank = priority(frame.id, frame.flags)
            self._waiting.append(_Waiting(passive, rank, self._number, index, operation))
            self._number += 1

    def _start(self, first: _Waiting) -> None:
        self._waiting.remove(first)
        self.frames += 1
        frame, timing = op.to_frame(first.operation), bit_rates(self.stations, self._timing)
        duration = frame_time_ns(len(frame.data), frame.flags, timing)
        if self._error_every and self.frames % self._error_every == 0:
            duration += -(-(ERROR_FRAME_BITS - INTERFRAME) * 1_000_000_000 // timing.bitrate)
        self.busy_ns += duration
        self._on_wire = self.now_ns + duration, first

    def _finish(self, sent: _Waiting) -> None:
        self._on_wire = None
        identifier = sent.operation.arguments[0]
        others = [s for k, s in enumerate(self.stations) if k != sent.station and s.status != op.BUS_OFF]
        sender = self.stations[sent.station]
        if self._error_every and self.frames % self._error_every == 0:
            self.destroyed += 1
            for place, station in enumerate([*others, sender]):
                flag = _SECONDARY if place else _PRIMARY
                arguments = identifier, _CRC_ERROR, flag, int(station is sender)
                station.inbox.append(Operation(Code.BUS_ERROR, arguments))
        else:
            for station in others:
                station.inbox.append(sent.operation)
            if others:
                sender.inbox.append(Operation(Code.CONFIRM, (identifier,)))
            self._on_frame(self.now_ns, sent.station, op.to_frame(sent.operation))
        for waiting in sorted(self._waiting):
            station = self.stations[waiting.station]
            if station.discards:
                self.lost += 1
                self._waiting.remove(waiting)
                lost = waiting.operation.arguments[0]
                station.inbox.append(Operation(Code.ARBITRATION_LOST, (lost,)))
