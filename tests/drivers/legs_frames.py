"""The protocol `legs` frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from drivers.controller_end import ControllerEnd
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import ALWAYS, DriveSetup, Frame, Received
from drivers.signals import LEGS, Command, Reaction
from drivers.tick_columns import Record, new_record
from hil.contracts.drives_end import answers, go_back, memory_of
from hil.contracts.messages import DeviceMessage, Sync, hear
from plant_fmu.drives import drives_end
from plant_fmu.drives.codec import DrivesEnd

SETUP = DriveSetup(0.01, Reaction.BRAKE, 1000.0)
COUNTER_AT = {0x100: 6, 0x101: 6, 0x110: 24, 0x120: 48}
"""Byte of the counter in each command; in layout ideal its lower half."""


def bitwise_crc(data: bytes, width: int) -> int:
    """CRC-8 of SAE J1850 or CRC-16/M17 (width 8 or 16), divided bit by bit as in a shift register."""
    polynomial, final = {8: (0x1D, 0xFF), 16: (0x5935, 0)}[width]
    register = (1 << width) - 1
    for byte in data:
        for position in range(7, -1, -1):
            carry = (register >> width - 1) ^ (byte >> position & 1)
            register = register << 1 & (1 << width) - 1
            if carry:
                register ^= polynomial
    return register ^ final


def resealed(frame: Frame, at: int, changed: bytes) -> Frame:
    """A frame with other bytes from `at` on and a correct check."""
    data, lead = bytearray(frame.data), bytes([frame.id % 256, frame.id // 256])
    data[at : at + len(changed)] = changed
    if frame.id == 0x110:
        data[26:28] = bitwise_crc(lead + bytes(data[:26]), 16).to_bytes(2, "little")
    else:
        data[-1] = bitwise_crc(lead + bytes(data[:-1]), 8)
    return frame._replace(data=bytes(data))


@cache
def _controller(protocol: Any) -> tuple[ControllerEnd, Any]:
    """Controller's end and its initial dialogue; cached, as some tests decode thousands of frames."""
    end = protocol.controller_end(SETUP)
    return end, end.remembered()


@cache
def _drives(protocol: Any) -> tuple[DrivesEnd, Any]:
    end = drives_end(protocol)
    return end, memory_of(end)


def decode(
    protocol: Any, frames: Sequence[Received], tick: int, last: Record | None = None, since_ns: int = ALWAYS
) -> Any:
    """Record of a tick with the drives' frames since `last`; None: since FIRST."""
    record = new_record()
    record["tick"] = tick
    end, start = _controller(protocol)
    end.remember(start)
    end.take(received_array(frames), new_record() if last is None else last, record, since_ns)
    return record


def opening(protocol: Any, tick: int) -> tuple[Frame, ...]:
    return sent_frames(_controller(protocol)[0].begin(tick))


def command_frames(protocol: Any, sent: Command, tick: int) -> tuple[Frame, ...]:
    return sent_frames(_controller(protocol)[0].give(sent, tick))


def heard(protocol: Any, frame: Frame, present: int = -1) -> tuple[DeviceMessage, ...]:
    """Messages of the drives for a frame after the SYNC `present` on each bus; -1: before any SYNC."""
    end, start = _drives(protocol)
    start["present"] = present
    go_back(end, start)
    return hear(end, frame)


def parse(protocol: Any, frame: Frame, present: int | None = None) -> DeviceMessage | None:
    """Message of the drives for a frame after the SYNC `present`; None: the counter of the command itself."""
    if present is None:
        at = COUNTER_AT.get(frame.id, len(frame.data))
        present = frame.data[at] if at < len(frame.data) else -1
    messages = heard(protocol, frame, present)
    assert len(messages) <= 1
    return messages[0] if messages else None


def one_feedback(
    protocol: Any, leg: int, length: float, rate: float, force: float, state: int, counter: int
) -> Frame:
    """Feedback of one drive to the SYNC with a counter."""
    l, dl, f = (np.full(LEGS, value, float) for value in (length, rate, force))
    return answers(protocol, Sync(counter), l, dl, f, np.full(LEGS, state, np.int64))[leg][1]
