"""Frames as records: what a bus receives and sends, what a codec reads and fills, what the log holds.

One element of FRAME is one frame, 80 bytes, from the bus to the log. `Received` and `Frame`
(`drivers.protocol`) are the same for people and tests.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from drivers.arrays import Rows
from drivers.protocol import BUS, Frame, Received

FRAME = np.dtype(
    [
        ("t_ns", "<i8"),
        ("id", "<u4"),
        ("kind", "u1"),
        ("length", "u1"),
        ("flags", "u1"),
        ("bus", "u1"),
        ("data", "u1", (64,)),
    ]
)
"""t_ns: the end of a received frame on the wire, ns; flags: EXTENDED to ERROR; bus: its index."""
RECEIVED, SENT = range(2)
"""Values of `kind`."""
NO_FRAMES: Rows = np.zeros(0, FRAME)
NO_FRAMES.flags.writeable = False


def _array(frames: Iterable[tuple[int, int, bytes, int]], count: int, kind: int) -> Rows:
    array = np.zeros(count, FRAME)
    data = array["data"]
    for k, (t_ns, identifier, content, flags) in enumerate(frames):
        array[k] = t_ns, identifier, kind, len(content), flags % BUS, flags // BUS, 0
        data[k, : len(content)] = np.frombuffer(content, np.uint8)
    return array


def received_array(frames: Sequence[Received]) -> Rows:
    """Return received frames as elements of FRAME, in their order."""
    return _array(((t_ns, *frame) for t_ns, frame in frames), len(frames), RECEIVED)


def sent_array(frames: Sequence[Frame]) -> Rows:
    """Return frames to send as elements of FRAME, in their order; nobody has sent them yet: t_ns is 0."""
    return _array(((0, *frame) for frame in frames), len(frames), SENT)


def sent_frames(array: Rows) -> tuple[Frame, ...]:
    """Return elements of FRAME as frames."""
    content, size = np.ascontiguousarray(array["data"]).tobytes(), FRAME["data"].itemsize
    flags = (array["flags"] + array["bus"].astype(np.int64) * BUS).tolist()
    rows = zip(array["id"].tolist(), array["length"].tolist(), flags, strict=True)
    return tuple(
        [
            Frame(each, content[k * size : k * size + length], bits)
            for k, (each, length, bits) in enumerate(rows)
        ]
    )


def received_frames(array: Rows) -> tuple[Received, ...]:
    """Return elements of FRAME as received frames."""
    return tuple(map(Received, array["t_ns"].tolist(), sent_frames(array)))


def same_frames(these: Rows, those: Rows) -> bool:
    """Tell whether frames are the same on the wire: all but their times."""
    if len(these) != len(those):
        return False
    words, others = (each.view(np.uint64).reshape(-1, FRAME.itemsize // 8)[:, 1:] for each in (these, those))
    return bool((words == others).all())
