"""Frames that a bus has received, deadlines, and the timing of a slow bus."""

from __future__ import annotations

import time

from drivers.arrays import Rows
from drivers.can.bus_time import BitTiming
from drivers.frame_array import received_frames
from drivers.protocol import Received

CRAWL = BitTiming(2_000, 2_000)
"""A frame of 8 bytes takes 67.5 ms: events during the frame happen in time even on a busy machine."""
CLASSIC_8_BYTES = 135
"""Worst-case bits: 135 us at 1 Mbit/s."""


def got(frames: Rows) -> list[Received]:
    """Elements of FRAME as received frames."""
    return [*received_frames(frames)]


def soon(seconds: float = 2.0) -> int:
    """Time `seconds` from now, ns."""
    return time.monotonic_ns() + int(seconds * 1e9)
