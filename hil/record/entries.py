"""What a log holds beside its rows: ticks, frames, events; and how ticks are put together."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.frame_array import FRAME, received_array, received_frames, sent_array, sent_frames, unpack_frames
from drivers.protocol import BUS, Frame, Received
from hil.record.ring import SENT
from hil.record.selection import as_bytes
from hil.signals import NUMBERS, ORDERS, Operator, Order, SetPoint

Commands = dict[int, list[tuple[int, int, tuple[float, ...]]]]
"""By tick: index, command and its numbers."""


class Tick:
    """One recorded tick."""

    _fields = ("row", "received", "sent", "operator", "setpoints", "orders")

    row: np.void
    """One element of `hil.record.log.Log.dtype`."""
    operator: tuple[int, ...]
    """Commands of the operator, numbers of `hil.signals.Operator`."""
    setpoints: tuple[SetPoint, ...]
    """For a live reference, in the order received."""
    orders: tuple[Order, ...]
    """For the motion, in the order received."""

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
        if isinstance(received, tuple):
            self.received = received
        else:
            self.received_items = received
        if isinstance(sent, tuple):
            self.sent = sent
        else:
            self.sent_items = sent

    @cached_property
    def received(self) -> tuple[Received, ...]:
        """In the order consumed."""
        return received_frames(self.received_items)

    @cached_property
    def sent(self) -> tuple[Frame, ...]:
        """In the order sent, SYNC first."""
        return sent_frames(self.sent_items)

    @cached_property
    def received_items(self) -> Rows:
        """The frames received as elements of FRAME, read-only."""
        return received_array(self.received)

    @cached_property
    def sent_items(self) -> Rows:
        """The frames sent, the same."""
        return sent_array(self.sent)

    def __iter__(self) -> Iterator[Any]:
        return (getattr(self, name) for name in self._fields)

    def __len__(self) -> int:
        return len(self._fields)

    def __getitem__(self, place: Any) -> Any:
        return tuple(self)[place]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Tick | tuple) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"Tick({', '.join(f'{name}={getattr(self, name)!r}' for name in self._fields)})"

    def _replace(self, **changes: Any) -> Tick:
        return Tick(**dict(zip(self._fields, self, strict=True)) | changes)


class Event(NamedTuple):
    """One recorded event."""

    t_ns: int
    """On the run's clock."""
    level: str
    """`debug`, `info`, `warning` or `error`."""
    text: str
    """What happened."""


class LoggedFrame(NamedTuple):
    """One CAN frame of a log."""

    t_ns: int
    """The end of a received frame on the wire, the tick of a sent one; on the run's clock."""
    tick: int
    """Tick that consumed or sent it."""
    sent: bool
    """Whether the writer of the log sent it."""
    bus: int
    """Index of the bus, from 0."""
    id: int
    """Identifier, without flags."""
    data: bytes
    """What it carries."""
    flags: int
    """Sum of EXTENDED 1, FD 2, BRS 4, ESI 8, REMOTE 16, ERROR 32."""


def logged(items: Rows) -> Iterator[LoggedFrame]:
    """Yield the frames of `items` (elements of `hil.record.decode.FRAME`) one by one."""
    frames = unpack_frames(items["frame"].tobytes())
    for (t_ns, can_id, kind, length, flags, data), tick in zip(frames, items["tick"].tolist(), strict=True):
        yield LoggedFrame(t_ns, tick, kind == SENT, flags // BUS, can_id, data[:length], flags % BUS)


def assemble(rows: Rows, items: Rows, commands: Commands) -> Iterator[Tick]:
    """Yield the ticks of `rows`, with their items."""
    key = items["tick"] * 2 + (items["frame"]["kind"] == SENT)
    order = np.lexsort((items["index"], key))
    key, frames = key[order], as_bytes(items["frame"])[order].view(FRAME)
    frames.flags.writeable = False
    wanted = rows["tick"] * 2
    first, middle, last = (np.searchsorted(key, wanted + k).tolist() for k in range(3))
    for row, tick, a, b, c in zip(rows, rows["tick"].tolist(), first, middle, last, strict=True):
        received, sent = frames[a:b], frames[b:c]
        if tick not in commands:
            yield Tick(row, received, sent, ())
            continue
        given = sorted(commands[tick])
        operator = tuple(command for _, command, _ in given if command not in NUMBERS)
        setpoints = tuple(SetPoint(*pose) for _, command, pose in given if command == Operator.SETPOINT)
        orders = tuple(
            Order(Operator(command), numbers) for _, command, numbers in given if command in ORDERS
        )
        yield Tick(row, received, sent, operator, setpoints, orders)
