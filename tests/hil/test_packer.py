"""The compiled packer of the recorder: its bytes are what protobuf reads as the messages that were recorded."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from enum import IntEnum, IntFlag
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from drivers.frame_array import FRAME
from drivers.protocol import BRS, BUS, ERROR, ESI, EXTENDED, FD, REMOTE
from drivers.tick_columns import Column
from hil.record import Recording
from hil.record.encode import CAN, TICK, Encoder
from hil.record.layout import RECORD_HEADER
from hil.record.machine_code import machine_code
from hil.record.packer import pack
from hil.record.ring import Batch, Ring
from hil.record.row import TICKS, Table
from hil.record.schema import message_class
from tests.hil.samples import random_rows, random_ticks, record

EPOCH, S = 1_700_000_000_123_456_789, 1_000_000_000
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def messages_of(encoder, batch, channel):
    """Return the messages on a channel, serialised again by protobuf."""
    made = encoder.encode(batch)
    kind = message_class(encoder.channels[channel][1])
    parsed = [kind.FromString(bytes(r[RECORD_HEADER:])) for r in made.records() if r[9] == channel]
    return [each.SerializeToString(deterministic=True) for each in parsed]


def row_message(kind, table, row):
    """Return the message of a row, filled in field by field."""
    message = kind()
    for c in table.columns:
        numbers = row[c.name].reshape(-1).tolist()
        name = f"{c.name}_number" if c.names else c.name
        shown = [n if 0 <= n < 127 else 127 for n in numbers] if c.names else []
        if c.elements:
            for element, n in zip(c.elements, numbers, strict=True):
                setattr(getattr(message, name), element, n)
            for element, n in zip(c.elements, shown, strict=bool(shown)):
                setattr(getattr(message, c.name), element, n)
        elif c.shape:
            getattr(message, name).extend(numbers)
            if shown:
                getattr(message, c.name).extend(shown)
        else:
            setattr(message, name, numbers[0])
        if issubclass(c.type, IntFlag):
            for flag, bit in c.names.items():
                setattr(getattr(message, c.name), flag, numbers[0] & bit != 0)
            getattr(message, c.name).SetInParent()
        elif shown and not c.shape:
            setattr(message, c.name, shown[0])
    return message.SerializeToString(deterministic=True)


def frame_message(kind, names, tick, index, t_ns, received, frame):
    """Return the message of a frame, filled in field by field."""
    message, bus = kind(), frame.flags // BUS
    message.header.stamp.seconds, message.header.stamp.nanos = divmod(EPOCH + t_ns, S)
    message.id, message.data, message.dlc = frame.id, frame.data, LENGTHS.index(len(frame.data))
    message.is_rtr, message.is_extended = frame.flags & REMOTE != 0, frame.flags & EXTENDED != 0
    message.is_error, message.fdf = frame.flags & ERROR != 0, frame.flags & FD != 0
    message.brs, message.esi = frame.flags & BRS != 0, frame.flags & ESI != 0
    message.channel, message.bus = names[min(bus, len(names) - 1)], bus
    message.direction, message.tick, message.index = 1 if received else 2, tick, index
    return message.SerializeToString(deterministic=True)


@pytest.mark.parametrize("names", [("can0",), ("front", "the rear bus " * 9)])
def test_rows_and_frames_are_those_recorded_over_turns_of_the_ring(names):
    ring = Ring.create(TICKS.dtype, 32)
    ring.close_fd()
    recording = Recording(ring, cast("Any", None), Path("a.mcap"), lockstep=True)
    ticks = random_ticks(300)
    encoder = Encoder(TICKS, epoch_ns=EPOCH, can_channels=names, scene=None)
    row_kind, frame_kind = (message_class(encoder.channels[k][1]) for k in (TICK, CAN))
    for first in range(0, 300, 12):
        part = ticks[first : first + 12]
        record(recording, part)
        batch = ring.take(32)
        assert messages_of(encoder, batch, TICK) == [row_message(row_kind, TICKS, t.row) for t in part]
        expected = []
        for t in part:
            tick, now = int(t.row["tick"]), int(t.row["t_ns"])
            all_of_it = [(r.t_ns, True, r.frame) for r in t.received] + [(now, False, f) for f in t.sent]
            for index, (t_ns, received, frame) in enumerate(all_of_it):
                expected.append(frame_message(frame_kind, names, tick, index, t_ns, received, frame))
        assert messages_of(encoder, batch, CAN) == expected
        ring.release(batch)


class Kind(IntEnum):
    NONE = 0
    ONE = 1
    MOST = 126


class Bits(IntFlag):
    LOW = 1
    HIGH = 1 << 62


def column(name, kind: Any = int, elements=(), shape=()):
    return Column("output", name, kind, "m", "what it is", tuple(elements), shape)


MANY = tuple(f"e{k}" for k in range(63))
TABLES = (
    (column("a", float, (), (3, 5)), column("b", int, MANY[:15], (15,)), column("c", float, MANY, (63,))),
    (column("kind", Kind), column("bits", Bits), column("kinds", Kind, (), (4,))),
    (column("named", Kind, MANY[:16], (16,)), column("one", float, ("x",), (1,)), column("last")),
)


@pytest.mark.parametrize("columns", TABLES, ids=["numbers", "names", "named elements"])
def test_one_kernel_packs_whatever_columns_a_table_has(columns):
    table = Table("/tick", (columns[0], column("t_ns"), *columns[1:], column("tick")))
    table.check()
    rows = random_rows(50, dtype=table.dtype)
    for c in columns:
        if c.names:
            numbers = [0, 1, 126, 127, 128, -1, 1 << 62, 255, 256]
            rows[c.name] = np.resize(numbers, rows[c.name].shape)
    encoder = Encoder(table, epoch_ns=EPOCH, can_channels=["can0"], scene=None)
    kind = message_class(encoder.channels[TICK][1])
    batch = Batch(rows, np.zeros(0, FRAME), np.zeros(0, np.int64))
    assert messages_of(encoder, batch, TICK) == [row_message(kind, table, row) for row in rows]


# -- in a process without Numba ------------------------------------------------------------------------------

OTHER = """
import hashlib, json, sys
import numpy as np
from hil.record.encode import Encoder
from hil.record.ring import FRAME, Batch
from hil.record.row import TICKS
import hil.record.recorder
code, rows, items = json.load(sys.stdin)
rows = np.frombuffer(bytes.fromhex(rows), TICKS.dtype)
items = np.frombuffer(bytes.fromhex(items), FRAME)
batch = Batch(rows, items, np.arange(5))
encoder = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None, packer=code)
print(hashlib.sha256(encoder.encode(batch).data).hexdigest(), "numba" in sys.modules)
"""


@pytest.mark.parametrize("plain", [False, True], ids=["machine code", "plain Python"])
def test_machine_code_alone_and_plain_python_pack_the_same(plain):
    rows = random_rows(5)
    items = np.frombuffer(np.random.default_rng(1).bytes(5 * FRAME.itemsize), FRAME).copy()
    items["kind"], items["length"], items["bus"] = [0, 1, 0, 1, 0], [0, 8, 64, 3, 12], 0
    items["t_ns"] = np.arange(5) * S
    here = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None)
    expected = here.encode(Batch(rows, items, np.arange(5))).data
    given = [None if plain else machine_code(pack), rows.tobytes().hex(), items.tobytes().hex()]
    environment = {**os.environ, **({"NUMBA_DISABLE_JIT": "1"} if plain else {})}
    done = subprocess.run(
        [sys.executable, "-c", OTHER], input=json.dumps(given), capture_output=True, text=True,
        env=environment, check=True, timeout=60,
    )  # fmt: skip
    assert done.stdout.split() == [hashlib.sha256(expected.tobytes()).hexdigest(), str(plain)]
