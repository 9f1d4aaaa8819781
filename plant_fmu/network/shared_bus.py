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
from plant_fmu.network.station import Station, bit_rates, exchange

_ROUNDS = 1000
"""Most exchanges at one instant."""
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

    def run(self, until_ns: int) -> None:
        """Simulate until `until_ns`, ns. Raises PlantError if an FMU fails or does not settle."""
        while True:
            self._settle()
            if self._on_wire is None:
                self._arbitrate()
            if self.now_ns >= until_ns:
                return
            self.now_ns = self._next(until_ns)
            on_grid = self.now_ns % self._step_ns == 0
            for station in self.stations:
                node = station.node
                if on_grid or node.fmu.step_ns or not node.terminal.countdown:
                    node.advance(self.now_ns)
            if self._on_wire is not None and self._on_wire[0] <= self.now_ns:
                self._finish(self._on_wire[1])

    def _next(self, until_ns: int) -> int:
        now = self.now_ns
        times = [until_ns, now - now % self._step_ns + self._step_ns]
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
                    self._accept(index, exchange(self.stations, index))
            if not busy:
                return
        raise PlantError(f"the CAN FMUs answer each other without end at {self.now_ns} ns")

    def _accept(self, index: int, operations: list[Operation]) -> None:
        for operation in operations:
            frame = op.to_frame(operation)
            self._waiting.append(_Waiting(priority(frame.id, frame.flags), self._number, index, operation))
            self._number += 1

    def _arbitrate(self) -> None:
        status = [station.status for station in self.stations]
        self._waiting = [each for each in self._waiting if status[each.station] != op.BUS_OFF]
        if self._waiting:
            self._start(min(self._waiting, key=lambda each: (status[each.station], each)))

    @property
    def _destroys(self) -> bool:
        """True if the frame on the wire, or the next one, is to be destroyed."""
        return self._error_every > 0 and (self.frames + self.destroyed + 1) % self._error_every == 0

    def _start(self, first: _Waiting) -> None:
        self._waiting.remove(first)
        frame, timing = op.to_frame(first.operation), bit_rates(self.stations, self._timing)
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
            self._on_frame(self.now_ns, sent.station, op.to_frame(sent.operation))
        for waiting in sorted(self._waiting):
            station = self.stations[waiting.station]
            if station.discards:
                self.lost += 1
                self._waiting.remove(waiting)
                lost = waiting.operation.arguments[0]
                station.inbox.append(Operation(Code.ARBITRATION_LOST, (lost,)))
