"""Station: one CAN FMU as a participant of a bus, and Stations: all of them."""

from drivers.can.bus_time import BitTiming
from drivers.errors import PlantError
from plant_fmu.network import operations as op
from plant_fmu.network.node import Node
from plant_fmu.network.operations import Code, Corrupt, Operation

_CONSUMED = {Code.CAN_TRANSMIT, Code.CAN_FD_TRANSMIT}
_ROUNDS = 1000
"""Most exchanges of one FMU at one instant."""


class Station:
    """A node, its status, its bit rates, its behaviour at a lost arbitration, and operations for it.

    Mutable state: all of these, and the counts of what it has sent and of what could not be read.
    """

    def __init__(self, node: Node) -> None:
        self.node = node
        self.status = op.ACTIVE
        self.rates: dict[int, int] = {}
        """Kind of rate -> bit/s, as the node has configured it."""
        self.discards = False
        self.inbox: list[Operation] = []
        self.sent = self.corrupt = self.reported = 0
        """Frames that it sent; its operations that could not be read; Format Errors that it reported."""

    def exchange(self) -> list[Operation]:
        """Give the node its inbox; returns its Transmit and Wakeup operations. Raises PlantError."""
        sent = self.node.exchange(self._packed())
        found = []
        for operation in op.decode(sent):
            if isinstance(operation, Corrupt):
                self.refuse(operation.data)
            elif operation.code is Code.CAN_XL_TRANSMIT:  # no bus here carries it
                self.refuse(op.encode([operation]))
            elif operation.code in _CONSUMED:
                if self.status != op.BUS_OFF:
                    self.sent += 1
                    found.append(operation)
            elif operation.code is Code.WAKEUP:
                found.append(operation)
            elif operation.code is Code.CONFIGURATION:
                kind, value = operation.arguments
                if kind == op.ARBITRATION_BEHAVIOR:
                    self.discards = value == op.DISCARD
                else:
                    self.rates[kind] = value
            elif operation.code is Code.STATUS:
                self.status = operation.arguments[0]
            elif operation.code is Code.FORMAT_ERROR:
                self.reported += 1
        return found

    def refuse(self, binary: bytes) -> None:
        """Count corrupt bytes from the node and answer them with a Format Error, unless they are one."""
        self.corrupt += 1
        if int.from_bytes(binary[:4], "little") != Code.FORMAT_ERROR:  # no answer to an answer
            most = self.node.fmu.most_bytes - op.HEADER.size - 2
            self.inbox.append(Operation(Code.FORMAT_ERROR, (), binary[: max(0, min(most, op.MAX_DATA))]))

    def _packed(self) -> bytes:
        """Operations of the inbox that fit into Rx_Data; the others stay for the next event."""
        packed, taken = b"", 0
        for operation in self.inbox:
            more = op.encode([operation])
            if len(packed) + len(more) > self.node.fmu.most_bytes and taken:
                break
            packed += more
            taken += 1
        del self.inbox[:taken]
        return packed


class Stations(list[Station]):
    """CAN FMUs on one bus. Mutable state: the stations."""

    def go(self, now_ns: int, step_ns: int) -> list[tuple[int, Operation]]:
        """Step the FMUs to `now_ns` and let them exchange until they settle.

        Returns their Transmit operations, each with the index of its station. A Wakeup goes to the others.
        An FMU with a countdown and without received operations is stepped at multiples of `step_ns`. Raises
        PlantError.
        """
        found: list[tuple[int, Operation]] = []
        for node in (station.node for station in self):
            if now_ns % step_ns == 0 or node.fmu.step_ns or not node.fmu.countdown:
                node.advance(now_ns)
        for _ in range(_ROUNDS):
            busy = False
            for index, station in enumerate(self):
                node, due_ns = station.node, station.node.next_ns()
                if station.inbox or (due_ns is not None and due_ns <= now_ns):
                    node.advance(now_ns)
                    if node.reached_ns == now_ns:
                        busy = True
                        found += self._exchange(index, station)
            if not busy:
                return found
        raise PlantError(f"the CAN FMUs send without end at {now_ns} ns: their time stands still")

    def _exchange(self, index: int, station: Station) -> list[tuple[int, Operation]]:
        found = station.exchange()
        wakeups = [each for each in found if each.code is Code.WAKEUP]
        for other in self:
            if other is not station:
                other.inbox += wakeups
        return [(index, each) for each in found if each.code is not Code.WAKEUP]

    def next_ns(self, now_ns: int, step_ns: int) -> int:
        """Next time, ns, at which `go` has work: a multiple of `step_ns`, a countdown, the end of a step."""
        times = [now_ns - now_ns % step_ns + step_ns]
        for node in (station.node for station in self):
            if step := node.fmu.step_ns:
                times.append(now_ns - now_ns % step + step)
            elif (due_ns := node.next_ns()) is not None:
                times.append(max(due_ns, now_ns))
        return min(times)

    def bit_rates(self, default: BitTiming) -> BitTiming:
        """Bit rates that the FMUs have configured, those of `default` where none has.

        Raises PlantError if two FMUs differ.
        """
        agreed: dict[int, int] = {}
        for station in self:
            for kind, rate in station.rates.items():
                if (known := agreed.setdefault(kind, rate)) != rate:
                    raise PlantError(
                        f"{station.node.name} configures {rate} bit/s, another FMU {known}: all FMUs of one "
                        "bus need the same bit rates"
                    )
        rates = agreed.get(op.CAN_RATE, default.bitrate), agreed.get(op.FD_RATE, default.data_bitrate)
        return BitTiming(*rates)
