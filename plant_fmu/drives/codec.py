"""Codec of emulated drives: base class `DrivesEnd`, and the records that it exchanges with the drives."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import FAILED, Pointed, data_at, record_at
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.protocol import Frame
from drivers.signals import LEGS
from drivers.transmission import loss_of

SYNC, COMMAND, UNWATCHED, ALIVE, CONFIGURE, REJECTED, STOP, ANSWER = range(8)
"""Kinds of a message:

- SYNC: the drives sample their encoders and answer; the answers contain `counter`, 0 in a protocol without
  one;
- COMMAND: `mode`, and `force` N for each leg. A repeated `counter` of a leg has no effect. The command
  belongs to the present SYNC: one of another SYNC is REJECTED;
- UNWATCHED: as COMMAND, but it does not feed the watchdogs: ALIVE does;
- ALIVE: feeds the watchdogs, in a protocol in which commands do not;
- CONFIGURE: set-up; `mode` is the reaction to a fault, `counter` the watchdog in ns;
- REJECTED: an invalid frame of our protocol;
- STOP: the drives fault at once;
- ANSWER: a frame of the start-up dialogue, sent at once by the drive; `counter` is the address of its FRAME.
"""
MESSAGE = np.dtype(
    [
        *((name, "<i8") for name in ("kind", "mode", "counter", "count")),
        ("legs", "<i8", (LEGS,)),
        ("force", "<f8", (LEGS,)),
    ]
)
"""Content of a controller's frame for drives; valid are the first `count` elements of `legs` and `force`."""
READING = np.dtype(
    [
        *((name, "<f8", (LEGS,)) for name in ("length", "rate", "force")),
        *((name, "<i8", (LEGS,)) for name in ("state", "fault")),
    ]
)
"""Readings of six drives: length m, rate m/s, force N; state DriveState, plus INVALID if length and rate are
invalid; fault DriveFault, for protocols whose feedback contains it."""
_MESSAGE = MESSAGE.itemsize
message_at: Any = record_at(record(MESSAGE))
reading_at: Any = record_at(record(READING))
MOST_MESSAGES = 64
"""Largest number of messages in one frame."""


@helper
def at_motor(of: Any, leg: int, reading: Any) -> tuple[float, float, float]:
    """Motor turns, turns/s and N m for a leg's length, rate and force; `of`: record with `FIELDS`."""
    force, rate = reading.force[leg], reading.rate[leg]
    loss = loss_of(force, rate, of.driving[leg], of.back_driving[leg], of.full_loss_m_s)
    turns = (reading.length[leg] - of.offset[leg]) / of.m_per_turn[leg]
    return turns, rate / of.m_per_turn[leg], loss * force / of.N_per_Nm[leg]


@helper
def put_message(messages: int, count: int, leg: int, kind: int, mode: int, counter: int, force: float) -> int:
    """Append a MESSAGE (kind, DriveMode, force N, > 0 extends) for a leg; returns the new count."""
    message = message_at(messages + count * _MESSAGE)
    message.kind, message.mode, message.counter, message.count = kind, mode, counter, 1
    message.legs[0], message.force[0] = leg, force
    return count + 1


class DrivesEnd:
    """The emulated drives' end of a drive family: decodes the controller's frames, encodes feedback.

    Mutable state: protocol state of six drives, initially powered up; messages of the last frame, valid until
    the next one.

    Compiled code calls three functions by address:

    - ``parse(context, frame, messages)``: number of messages filled in, FAILED to leave the frame to
      `converse`;
    - ``answer(context, sync, reading, frames, legs)``: number of frames filled in, with the leg of each;
      FAILED if a reading is not finite;
    - ``report(context, leg, state, fault, watchdog, reaction, due, frames)``: number of frames filled in.
      watchdog: ns, -1 before the drive is set up; due: 1 at a heartbeat, 0 at a change of state.

    All arguments are integers: addresses of FRAME, MESSAGE, READING and int64, and numbers.
    """

    def __init__(self, record: Rows, parse: Pointed, answer: Pointed, report: Pointed) -> None:
        """Create an end; record: context of its three functions, with the drives' protocol state."""
        self.record = self.state = record
        self.parse, self.answer, self.report = parse, answer, report
        self.messages, self._frames = np.zeros(MOST_MESSAGES, MESSAGE), np.zeros(MOST_MESSAGES, FRAME)
        self._count = 0

    def converse(self, frame: Frame) -> None:
        """Process a frame in Python (set-up, identification, stop); it acts by `put` and `say`."""
        raise NotImplementedError

    def put(
        self, kind: int, legs: Sequence[int] = (), mode: int = 0, counter: int = 0, force: float = 0.0
    ) -> None:
        """Append a message to those of the present frame; legs: addressees; force: N, push positive."""
        message: Any = self.messages[self._count]
        message["kind"], message["mode"] = kind, mode
        message["counter"], message["count"] = counter, len(legs)
        message["legs"][: len(legs)], message["force"] = legs, force
        self._count += 1

    def say(self, leg: int, frame: Frame) -> None:
        """Append a frame of a start-up dialogue, which the drive of a leg sends at once."""
        into = self._frames[self._count :]
        into[:1] = sent_array([frame])
        self.put(ANSWER, (leg,), counter=data_at(into))

    def hear(self, frame: Frame) -> Rows:
        """Commands (MESSAGEs) to drives that a frame contains; empty if it addresses no drive."""
        self._count = self.parse(self.record, sent_array([frame]), self.messages)
        if self._count == FAILED:
            self._count = 0
            self.converse(frame)
        return self.messages[: self._count]

    def announce(self, leg: int, state: int) -> tuple[Frame, ...]:
        """Frames that a drive sends at its heartbeat before it is set up."""
        count = self.report(self.record, leg, state, 0, -1, 0, 1, self._frames)
        return sent_frames(self._frames[:count])

    def restart(self, legs: Sequence[int]) -> None:
        """Restore the power-up protocol state of drives that were switched off and on; none by default."""
