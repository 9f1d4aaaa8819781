"""Station: one CAN FMU as a participant of a bus, with what the standard makes the bus remember of it."""

from collections.abc import Iterable, Sequence

from drivers.can.bus_time import BitTiming
from drivers.errors import PlantError
from plant_fmu.network import operations as op
from plant_fmu.network.node import Node
from plant_fmu.network.operations import Code, Corrupt, Operation

_CONSUMED = {Code.CAN_TRANSMIT, Code.CAN_FD_TRANSMIT}


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
            most = self.node.terminal.most_bytes - op.HEADER.size - 2
            self.inbox.append(op.format_error(binary, most))

    def _packed(self) -> bytes:
        """Operations of the inbox that fit into Rx_Data; the others stay for the next event."""
        packed, taken = b"", 0
        for operation in self.inbox:
            more = op.encode([operation])
            if len(packed) + len(more) > self.node.terminal.most_bytes and taken:
                break
            packed += more
            taken += 1
        del self.inbox[:taken]
        return packed


def exchange(stations: Sequence[Station], index: int) -> list[Operation]:
    """Exchange with station `index`; returns its Transmit operations. A Wakeup goes to the others."""
    found = stations[index].exchange()
    if wakeups := [each for each in found if each.code is Code.WAKEUP]:
        for station in (*stations[:index], *stations[index + 1 :]):
            station.inbox += wakeups
    return [each for each in found if each.code is not Code.WAKEUP] if wakeups else found


def bit_rates(stations: Iterable["Station"], default: BitTiming) -> BitTiming:
    """Bit rates that the nodes have configured, those of `default` where none has.

    Raises PlantError if two nodes differ.
    """
    agreed: dict[int, tuple[int, str]] = {}
    for station in stations:
        for kind, rate in station.rates.items():
            known, other = agreed.setdefault(kind, (rate, station.node.name))
            if known != rate:
                raise PlantError(
                    f"{station.node.name} configures {rate} bit/s, {other} {known}: nodes of one bus need "
                    "the same bit rates"
                )
    rates = {kind: rate for kind, (rate, _) in agreed.items()}
    return BitTiming(rates.get(op.CAN_RATE, default.bitrate), rates.get(op.FD_RATE, default.data_bitrate))
