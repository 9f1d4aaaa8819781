"""Buses between both ends of a simulation: their frames in arrays, and the time when each is free."""

from collections.abc import Sequence
from contextlib import suppress
from functools import cache

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.compiled.pointed import data_at
from drivers.errors import BusError
from drivers.family import Family
from drivers.frame_array import FRAME, sent_frames
from drivers.protocol import ALWAYS
from hil.app.sim.wire_kernels import FLAGS, FULL, LENGTHS, ROW, WIRES

_ROOM = 128
FRAME_WORDS = FRAME.itemsize // 8


@cache
def frame_times_ns(timing: BitTiming | None) -> Ints:
    """Worst-case duration of frames, ns, by data length and flags; -1: invalid frame; 0 without timing."""
    times = np.zeros((LENGTHS, FLAGS), np.int64)
    if timing is not None:
        times[:] = -1
        for length, flags in np.ndindex(LENGTHS, FLAGS):
            with suppress(BusError):
                times[length, flags] = frame_time_ns(length, flags, timing)
    return times


class Wires:
    """Buses between both ends of a simulation: data of the kernels `begin`, `answer` and `command`.

    Mutable state: the transmit queue, when each bus falls free, the frames on their way to either end.
    """

    def __init__(self, timings: Sequence[BitTiming | None], protocol: Family) -> None:
        """timings: bit timing of each bus, None if frames take no time; protocol: of the controller's end."""
        self._timings, self._protocol = timings, protocol
        self.times_ns = np.array(list(map(frame_times_ns, timings)))
        self._free = np.full(len(timings), ALWAYS)
        self.wanted = list(protocol.wanted) if protocol.traits.feedback_ids else []
        """Identifiers of the answers to a SYNC or poll."""
        self._wanted = np.array(self.wanted, np.int64)
        self._missing = np.zeros_like(self._wanted)
        self.record = w = np.zeros((), WIRES)
        w["buses"], w["free"], w["times"] = len(timings), data_at(self._free), data_at(self.times_ns)
        w["fresh"], w["addressed"] = protocol.fresh_by.address, protocol.addressed_by.address
        w["tables"] = protocol.context
        w["wanted_at"], w["wanted"], w["missing_at"] = (
            data_at(self._wanted), self._wanted.size, data_at(self._missing)
        )  # fmt: skip
        self._queue, self._commands, self._late = (np.zeros(0, np.int64) for _ in range(3))
        self._reserve(_ROOM)

    def _reserve(self, room: int) -> None:
        w = self.record
        held = (self._queue, self._commands, self._late)
        new = [np.zeros(room * size, np.int64) for size in (ROW, FRAME_WORDS, FRAME_WORDS)]
        for into, before in zip(new, held, strict=True):
            into[: before.size] = before
        self._queue, self._commands, self._late = new
        w["queue"], w["commands_at"], w["late_at"], w["room"] = *map(data_at, new), room
        self.commands: Rows = self._commands.view(FRAME)
        """Frames for the drives: the first `record["commands"]`."""
        self.late: Rows = self._late.view(FRAME)
        """Frames for the controller: the first `record["taken"]`, then later ones."""

    def settle(self, status: int, frames: Rows) -> None:
        """Make room after a kernel's status FULL, so that the kernel can be called again.

        Raises BusError for a frame that no bus can carry.
        """
        if status == FULL:
            self._reserve(2 * (int(self.record["room"]) + len(frames)))
            return
        for frame in sent_frames(frames):
            timing = self._timings[frame.bus]
            if timing is not None:
                frame_time_ns(len(frame.data), frame.flags % FLAGS, timing)
