"""The own protocol frame by frame: it remembers nothing between them but who has been set up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.protocol import ALWAYS, DeviceMessage, DriveProtocol, Frame, Received, Sync, run_of
from drivers.signals import LEGS, Command
from drivers.tick_columns import Record, new_record


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
    protocol.decode(None, run_of(frames), new_record() if last is None else last, record, since_ns)
    return record


def command_frames(protocol: DriveProtocol, sent: Command, tick: int) -> tuple[Frame, ...]:
    """Return the frames of a command."""
    return protocol.command(None, sent, tick)[1]


def parse(protocol: DriveProtocol, frame: Frame) -> DeviceMessage | None:
    """Return what the drives make of a frame."""
    _, messages = protocol.parse(None, frame)
    assert len(messages) <= 1
    return messages[0] if messages else None


def one_feedback(
    protocol: DriveProtocol, leg: int, length: float, rate: float, force: float, state: int, counter: int
) -> Frame:
    """Return one drive's feedback to the SYNC with a counter."""
    l, dl, f = (np.full(LEGS, value, float) for value in (length, rate, force))
    return protocol.feedbacks(Sync(counter), l, dl, f, np.full(LEGS, state, np.int64))[leg][1]
