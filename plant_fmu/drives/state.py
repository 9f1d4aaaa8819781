"""What six drives and their pass keep in arrays: the record, and what its addresses lead to."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.compiled.pointed import data_at
from drivers.ends import MESSAGE, READING, DrivesEnd, put_messages
from drivers.frame_array import FRAME, timed_array
from drivers.protocol import DeviceMessage, Frame
from drivers.signals import LEGS
from drivers.tick_columns import Record
from drivers.transmission import Transmission
from plant_fmu.drives.kernels import NEVER_NS
from plant_fmu.drives.live import due_ns
from plant_fmu.drives.record import MESSAGES, NODES, ROOM
from plant_fmu.plant import Moved

_AT: dict[str, int] = {name: NODES.fields[name][1] // 8 for name in NODES.names or ()}  # type: ignore[index]
NOW, SENT, MESSAGE_AT, SYNCS = (_AT[name] for name in ("now_ns", "sent", "message", "syncs"))
"""Places of integers in `State.words`."""


class State:
    """Six drives and their time, see `record.NODES`.

    Mutable state: the record, frames to send, messages heard, and the reading that is answered.
    """

    def __init__(self, t0_ns: int, n: Record, end: DrivesEnd, plant: Moved) -> None:
        """Power up at `t0_ns` with the record of the drives, their end and the plant behind them."""
        self._keeps = end, plant
        self.record = n
        self.address = data_at(n)
        self.words = n.reshape(1).view(np.int64).data
        """The same as integers, quick to get at."""
        self.out = np.zeros(ROOM, FRAME)
        """Frames to send: the first `words[SENT]`."""
        self.messages, self.asked = np.zeros(ROOM, MESSAGE), np.zeros((), MESSAGE)
        self.reading, self._senders = np.zeros((), READING), np.zeros(ROOM, np.int64)
        n["move"], n["applied"], n["plant"] = plant.move, plant.applied, plant.context
        n["parse"], n["answer"], n["report"], n["end"] = end.parse, end.answer, end.report, end.context
        n["messages"], n["asked"] = data_at(self.messages), data_at(self.asked)
        n["reading"], n["senders"] = data_at(self.reading), data_at(self._senders)
        n["out"], n["room"] = data_at(self.out), ROOM
        n["t0_ns"] = n["now_ns"] = n["calm_ns"] = t0_ns
        n["sense_ns"] = NEVER_NS

    def drive_by(self, transmission: Transmission) -> None:
        """Put losses between motors and legs."""
        n = self.record
        n["geared"], n["full_loss_m_s"] = True, transmission.full_loss_m_s
        n["driving"], n["back_driving"] = transmission.driving, transmission.back_driving

    def speak(self, heartbeat_ns: float, reading_ns: float) -> None:
        """Let each drive send its status, and its reading unasked, so often; 0: never."""
        n = self.record
        t0_ns = int(n["t0_ns"])
        n["beat_share"], n["reading_share"] = heartbeat_ns / LEGS, reading_ns / LEGS
        n["beat_ns"] = due_ns(t0_ns, 0, heartbeat_ns / LEGS)
        n["reading_ns"] = due_ns(t0_ns, 1, reading_ns / LEGS)

    def reserve(self, room: int) -> None:
        """Make room for frames to send."""
        out = np.zeros(room, FRAME)
        out[: self.words[SENT]] = self.out[: self.words[SENT]]
        self.out = out
        self.record["out"], self.record["room"] = data_at(out), room

    def queue(self, t_ns: int, frames: Sequence[Frame]) -> None:
        """Send frames, at an instant."""
        before = self.words[SENT]
        after = before + len(frames)
        if after > len(self.out):
            self.reserve(2 * after)
        self.out[before:after] = timed_array([(t_ns, frame) for frame in frames])
        self.words[SENT] = after

    def hear(self, messages: Sequence[DeviceMessage]) -> None:
        """Take what the present frame says."""
        n: Any = self.record
        if len(messages) > len(self.messages):
            self.messages = np.zeros(2 * len(messages), MESSAGE)
            n["messages"] = data_at(self.messages)
        put_messages(messages, self.messages)
        n["heard"], n["message"], n["place"] = len(messages), 0, MESSAGES
