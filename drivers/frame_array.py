"""Frames as 80-byte records of the dtype FRAME: for buses, codecs and the log.

A frame stays such a record from the bus to the log. `Received` and `Frame` (`drivers.protocol`) are the
Python objects with equal content, for people and tests.
"""

import struct
from collections.abc import Iterable

import numpy as np

from drivers.arrays import Rows
from drivers.protocol import Frame, Received

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
"""t_ns: end of a received frame on the wire, ns; flags: EXTENDED to ERROR; bus: its index."""
_FRAME = struct.Struct("<qIBBH64s")
frame_bytes, pack_frame, unpack_frames = _FRAME.pack, _FRAME.pack_into, _FRAME.iter_unpack
"""frame_bytes(t_ns, id, kind, length, flags, data), pack_frame(buffer, offset, and the same),
unpack_frames(bytes); the high byte of the flags is the bus."""
RECEIVED, SENT = range(2)
"""Values of `kind`."""
NO_FRAMES: Rows = np.zeros(0, FRAME)
NO_FRAMES.flags.writeable = False


def timed_array(frames: Iterable[tuple[int, Frame]], kind: int = SENT) -> Rows:
    """Read-only FRAME records from pairs (time ns, frame), in their order; kind: RECEIVED or SENT."""
    content = [
        frame_bytes(t_ns, identifier, kind, len(data), flags, data)
        for t_ns, (identifier, data, flags) in frames
    ]
    return np.frombuffer(b"".join(content), FRAME)


def received_array(frames: Iterable[Received]) -> Rows:
    """Read-only FRAME records from received frames."""
    return timed_array(frames, RECEIVED)


def sent_array(frames: Iterable[Frame]) -> Rows:
    """Read-only FRAME records from frames to send; t_ns is 0, as they are not sent yet."""
    return timed_array((0, frame) for frame in frames)


def joined(parts: Iterable[Rows]) -> Rows:
    """Concatenation of arrays of FRAME, in memory of its own."""
    return np.frombuffer(bytearray().join([part.tobytes() for part in parts]), FRAME)


def sent_at(t_ns: int, *parts: Rows) -> Rows:
    """Concatenation of arrays of FRAME, with t_ns set to the time of sending, ns."""
    sent = joined(parts)
    sent["t_ns"] = t_ns
    return sent


def received_frames(array: Rows) -> tuple[Received, ...]:
    """FRAME records as `Received` objects."""
    return tuple(
        [
            Received(t_ns, Frame(identifier, data[:size], flags))
            for t_ns, identifier, _, size, flags, data in unpack_frames(array.tobytes())
        ]
    )


def sent_frames(array: Rows) -> tuple[Frame, ...]:
    """FRAME records as `Frame` objects."""
    return tuple([frame for _, frame in received_frames(array)])
