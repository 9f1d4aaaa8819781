"""Ticks, CAN frames, commands and events of a log, and the assembly of ticks from rows and frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.frame_array import FRAME, received_array, received_frames, sent_array, sent_frames, unpack_frames
from drivers.protocol import BUS, Frame, Received
from hil.record.ring import SENT
from hil.record.selection import as_bytes
from hil.signals import NUMBERS, ORDERS, Operator, Order, SetPoint


class Tick:
    """One recorded tick: its row, its frames received and sent, and its operator commands."""

    row: np.void
    """One element of `hil.record.log.Log.dtype`."""
    received_items: Rows
    """Received frames as elements of FRAME."""
    sent_items: Rows
    """Sent frames as elements of FRAME."""
    operator: tuple[int, ...]
    """Operator commands, as numbers of `hil.signals.Operator`."""
    setpoints: tuple[SetPoint, ...]
    """Set-points for a live reference, in the order received."""
    orders: tuple[Order, ...]
    """Motion commands, in the order received."""

    def __init__(
        self,
        row: np.void,
        received: tuple[Received, ...] | Rows,
        sent: tuple[Frame, ...] | Rows,
        operator: tuple[int, ...],
        setpoints: tuple[SetPoint, ...] = (),
        orders: tuple[Order, ...] = (),
    ) -> None:
        self.row, self.operator, self.setpoints, self.orders = row, operator, setpoints, orders
        self.received_items = received_array(received) if isinstance(received, tuple) else received
        self.sent_items = sent_array(sent) if isinstance(sent, tuple) else sent

    @cached_property
    def received(self) -> tuple[Received, ...]:
        """CAN frames received, in the order in which the control cycle consumed them."""
        return received_frames(self.received_items)

    @cached_property
    def sent(self) -> tuple[Frame, ...]:
        """CAN frames sent, in the order sent, SYNC first."""
        return sent_frames(self.sent_items)

    def _replace(self, **changes: Any) -> Tick:
        given: dict[str, Any] = {"received": self.received_items, "sent": self.sent_items}
        given |= {name: getattr(self, name) for name in ("row", "operator", "setpoints", "orders")}
        return Tick(**given | changes)


class Command(NamedTuple):
    """One recorded operator command with its tick and its numbers."""

    tick: int
    place: int
    """Position within the tick."""
    operator: Operator
    numbers: tuple[float, ...]


class Event(NamedTuple):
    """One recorded event: a text with time and level."""

    t_ns: int
    """Time of the event on the run's clock, ns."""
    level: str
    """`debug`, `info`, `warning` or `error`."""
    text: str
    """Message of the event."""


class LoggedFrame(NamedTuple):
    """One CAN frame of a log, received or sent, with its time and tick."""

    t_ns: int
    """End of a received frame on the wire, or tick of a sent frame; on the run's clock."""
    tick: int
    """Tick that consumed or sent the frame."""
    sent: bool
    """True for a frame that the writer of the log sent."""
    bus: int
    """Index of the bus, from 0."""
    id: int
    """Identifier, without flags."""
    data: bytes
    """Payload."""
    flags: int
    """Sum of EXTENDED 1, FD 2, BRS 4, ESI 8, REMOTE 16, ERROR 32."""


def logged(items: Rows) -> Iterator[LoggedFrame]:
    """Yield CAN frames one by one from `items` (n,) of `hil.record.layout.ITEM`."""
    frames = unpack_frames(items["frame"].tobytes())
    for (t_ns, can_id, kind, length, flags, data), tick in zip(frames, items["tick"].tolist(), strict=True):
        yield LoggedFrame(t_ns, tick, kind == SENT, flags // BUS, can_id, data[:length], flags % BUS)


def assemble(rows: Rows, items: Rows, commands: Iterable[Command]) -> Iterator[Tick]:
    """Yield the ticks of `rows` (n,), each with its frames from `items` (m,) of ITEM and its commands."""
    key = items["tick"] * 2 + (items["frame"]["kind"] == SENT)
    order = np.lexsort((items["index"], key))
    key, frames = key[order], as_bytes(items["frame"])[order].view(FRAME)
    frames.flags.writeable = False
    wanted = rows["tick"] * 2
    first, middle, last = (np.searchsorted(key, wanted + k).tolist() for k in range(3))
    by_tick: dict[int, list[Command]] = {}
    for command in sorted(commands):
        by_tick.setdefault(command.tick, []).append(command)
    for row, tick, a, b, c in zip(rows, rows["tick"].tolist(), first, middle, last, strict=True):
        given = by_tick.get(tick, ())
        yield Tick(
            row,
            frames[a:b],
            frames[b:c],
            tuple(each.operator for each in given if each.operator not in NUMBERS),
            tuple(SetPoint(*each.numbers) for each in given if each.operator == Operator.SETPOINT),
            tuple(Order(each.operator, each.numbers) for each in given if each.operator in ORDERS),
        )
