"""What a log holds beside its rows: ticks, frames, events; and how ticks are put together."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.protocol import BUS, Frame, Received
from hil.record.layout import MAX_DATA
from hil.record.schema import RX, TX
from hil.signals import NUMBERS, ORDERS, Operator, Order, SetPoint

Commands = dict[int, list[tuple[int, int, tuple[float, ...]]]]
"""By tick: index, command and its numbers."""


class Tick(NamedTuple):
    """One recorded tick."""

    row: np.void
    """One element of `hil.record.log.Log.dtype`."""
    received: tuple[Received, ...]
    """In the order consumed."""
    sent: tuple[Frame, ...]
    """In the order sent, SYNC first."""
    operator: tuple[int, ...]
    """Commands of the operator, numbers of `hil.signals.Operator`."""
    setpoints: tuple[SetPoint, ...] = ()
    """For a live reference, in the order received."""
    orders: tuple[Order, ...] = ()
    """For the motion, in the order received."""


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


def _contents(items: Rows) -> list[bytes]:
    """Return the data bytes of frames."""
    data = np.ascontiguousarray(items["data"]).tobytes()
    starts = range(0, len(data), MAX_DATA)
    return [data[a : a + n] for a, n in zip(starts, items["length"].tolist(), strict=True)]


def logged(items: Rows) -> Iterator[LoggedFrame]:
    """Yield the frames of `items` (elements of `hil.record.decode.ITEM`) one by one."""
    columns = (items[name].tolist() for name in ("t_ns", "tick", "direction", "bus", "id"))
    for t_ns, tick, direction, bus, can_id, data, flags in zip(
        *columns, _contents(items), items["flags"].tolist(), strict=True
    ):
        yield LoggedFrame(t_ns, tick, direction == TX, bus, can_id, data, flags)


def assemble(rows: Rows, items: Rows, commands: Commands) -> Iterator[Tick]:
    """Yield the ticks of `rows`, with their items."""
    items = items[np.isin(items["direction"], (RX, TX))]
    items = items[np.lexsort((items["index"], items["direction"], items["tick"]))]
    flags = items["flags"] + items["bus"].astype(np.int64) * BUS
    frames = list(map(Frame, items["id"].tolist(), _contents(items), flags.tolist()))
    received = list(map(Received, items["t_ns"].tolist(), frames))
    key = items["tick"] * 2 + (items["direction"] == TX)
    wanted = rows["tick"] * 2
    first, middle, last = (np.searchsorted(key, wanted + k).tolist() for k in range(3))
    for row, tick, a, b, c in zip(rows, rows["tick"].tolist(), first, middle, last, strict=True):
        tick_received, tick_sent = tuple(received[a:b]), tuple(frames[b:c])
        if tick not in commands:
            yield Tick(row, tick_received, tick_sent, ())
            continue
        given = sorted(commands[tick])
        operator = tuple(command for _, command, _ in given if command not in NUMBERS)
        setpoints = tuple(SetPoint(*pose) for _, command, pose in given if command == Operator.SETPOINT)
        orders = tuple(
            Order(Operator(command), numbers) for _, command, numbers in given if command in ORDERS
        )
        yield Tick(row, tick_received, tick_sent, operator, setpoints, orders)
