"""The own protocol frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from drivers.frame_array import received_array
from drivers.protocol import ALWAYS, DeviceMessage, DriveProtocol, DriveSetup, Frame, Received, Sync
from drivers.signals import LEGS, Command, Reaction
from drivers.tick_columns import Record, new_record
from tests.drivers.drives_end import answers

SETUP = DriveSetup(0.01, Reaction.BRAKE, 1000.0)
COUNTER_AT = {0x100: 6, 0x101: 6, 0x110: 24, 0x120: 48}
"""Byte of the counter of each command; in the lower half of it in layout ideal."""


@cache
def _dialogue(protocol: DriveProtocol) -> Any:
    """Return a dialogue at its start, made once: listeners decode thousands of frames a second."""
    return protocol.start(SETUP)


def decode(
    protocol: DriveProtocol,
    frames: Sequence[Received],
    tick: int,
    last: Record | None = None,
    since_ns: int = ALWAYS,
) -> Any:
    """Return the record of a tick with what the drives said since the last one, FIRST if there is none."""
    record = new_record()
    record["tick"] = tick
    key: Any = protocol
    protocol.decode(
        _dialogue(key), received_array(frames), new_record() if last is None else last, record, since_ns
    )
    return record


def command_frames(protocol: DriveProtocol, sent: Command, tick: int) -> tuple[Frame, ...]:
    """Return the frames of a command."""
    return protocol.command(None, sent, tick)[1]


def parse(protocol: DriveProtocol, frame: Frame, present: int | None = None) -> DeviceMessage | None:
    """Return what the drives make of a frame after the SYNC `present`; None: that of a command itself."""
    if present is None:
        at = COUNTER_AT.get(frame.id, len(frame.data))
        present = frame.data[at] if at < len(frame.data) else -1
    _, messages = protocol.parse(present, frame)
    assert len(messages) <= 1
    return messages[0] if messages else None


def one_feedback(
    protocol: DriveProtocol, leg: int, length: float, rate: float, force: float, state: int, counter: int
) -> Frame:
    """Return one drive's feedback to the SYNC with a counter."""
    l, dl, f = (np.full(LEGS, value, float) for value in (length, rate, force))
    return answers(protocol, Sync(counter), l, dl, f, np.full(LEGS, state, np.int64))[leg][1]
