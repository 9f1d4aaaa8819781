"""Random ticks for tests of recording: no value is zero by default, so that a missing value cannot pass."""

import numpy as np

from drivers.frame_array import FRAME
from drivers.protocol import BRS, BUS, ESI, EXTENDED, FD, Frame, Received
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.encode import TICK, Encoder
from hil.record.layout import RECORD_HEADER
from hil.record.log import Tick
from hil.record.ring import Batch
from hil.signals import Operator, Order, SetPoint

FLAGS = (0, EXTENDED, FD, FD | BRS, FD | BRS | ESI | EXTENDED, BUS, 127 * BUS | FD)
CAN_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
PERIOD_NS = 1_000_000


def random_rows(count, seed=1, dtype=ROW):
    rng = np.random.default_rng(seed)
    rows = np.frombuffer(
        rng.bytes(count * dtype.itemsize), dtype
    ).copy()  # NaN, infinities, extremes: all bits
    rows["tick"] = np.arange(count)
    rows["t_ns"] = np.arange(count) * PERIOD_NS + 12345
    return rows


def packed_rows(table, rows):
    """Messages of rows as the recorder packs them, without the headers of their records."""
    encoder = Encoder(table, epoch_ns=0, can_channels=["can0"], scene=None)
    made = encoder.encode(Batch(rows, np.zeros(0, FRAME), np.zeros(0, np.int64)))
    records = [bytes(each) for each in made.records()]
    return [each[RECORD_HEADER:] for each in records if each[9] == TICK]


def random_frame(rng):
    flags = FLAGS[rng.integers(len(FLAGS))]
    length = CAN_LENGTHS[rng.integers(16 if flags & FD else 9)]
    return Frame(int(rng.integers(1 << 29 if flags & EXTENDED else 1 << 11)), rng.bytes(length), flags)


def random_ticks(count, seed=1, dtype=ROW):
    rng = np.random.default_rng(seed)
    ticks = []
    for row in random_rows(count, seed, dtype):
        now = int(row["t_ns"])
        received = tuple(
            Received(now - int(rng.integers(PERIOD_NS)), random_frame(rng)) for _ in range(rng.integers(9))
        )
        sent = tuple(random_frame(rng) for _ in range(rng.integers(4)))
        operator = tuple(int(k) for k in rng.integers(1, 5, rng.integers(3))) if rng.random() < 0.05 else ()
        setpoints = tuple(
            SetPoint(*rng.normal(size=6)) for _ in range(rng.integers(3) * (rng.random() < 0.05))
        )
        given = (Order(Operator.SPEED, (float(rng.random()),)), Order(Operator.KEY), Order(Operator.HOLD))
        orders = given[: rng.integers(4)] if rng.random() < 0.05 else ()
        ticks.append(Tick(row, received, sent, operator, setpoints, orders))
    return ticks


def record(recording, ticks):
    for tick in ticks:
        recording.tick(
            np.asarray(tick.row), tick.received, tick.sent, tick.operator, tick.setpoints, tick.orders
        )


def log_of(ticks, folder, configuration="a: 1\n", can_channel="can0"):
    """Path of a log of ticks in a new folder `log`."""
    path = folder.mktemp("log") / "a.mcap"
    with Recording.start(
        path, configuration=configuration, lockstep=True, can_channel=can_channel
    ) as recording:
        record(recording, ticks)
    return path


def assert_same(found, expected):
    found = list(found)
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        assert a.row.tobytes() == b.row.tobytes()
        assert (a.received, a.sent, a.operator) == (b.received, b.sent, b.operator)
        assert (a.setpoints, a.orders) == (b.setpoints, b.orders)
