"""The drives' end of a family: what the emulated drives call, and the records that go between."""

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

- SYNC: the drives latch their encoders and answer; `counter` is in the answers, 0 in a protocol without one;
- COMMAND: `mode`, `force` N for each leg; one with the `counter` of the leg's command before is a repetition
  and does not count. Whether it is that of the present SYNC has been checked: another one is REJECTED;
- UNWATCHED: the same, but it does not feed the watchdogs: ALIVE does;
- ALIVE: what the watchdogs wait for, where that is not the command itself;
- CONFIGURE: set-up; `mode` is the reaction, `counter` the watchdog in ns;
- REJECTED: a frame of ours that cannot be trusted;
- STOP: the drives fault at once;
- ANSWER: a drive's own part of the start-up dialogue, sent at once; `counter` is the address of its FRAME.
"""
MESSAGE = np.dtype(
    [
        *((name, "<i8") for name in ("kind", "mode", "counter", "count")),
        ("legs", "<i8", (LEGS,)),
        ("force", "<f8", (LEGS,)),
    ]
)
"""What a frame of a controller says to the first `count` drives of `legs`."""
READING = np.dtype(
    [
        *((name, "<f8", (LEGS,)) for name in ("length", "rate", "force")),
        *((name, "<i8", (LEGS,)) for name in ("state", "fault")),
    ]
)
"""What six drives read: length m, rate m/s, force N; state DriveState, plus INVALID where length and rate are
of no use; fault DriveFault, for protocols whose feedback names it."""
_MESSAGE = MESSAGE.itemsize
message_at: Any = record_at(record(MESSAGE))
reading_at: Any = record_at(record(READING))
MOST_MESSAGES = 64
"""Of one frame."""


@helper
def at_motor(of: Any, leg: int, reading: Any) -> tuple[float, float, float]:
    """Return turns, turns/s and N m of a leg's motor, of its length, rate and force; of: has `FIELDS`."""
    force, rate = reading.force[leg], reading.rate[leg]
    loss = loss_of(force, rate, of.driving[leg], of.back_driving[leg], of.full_loss_m_s)
    turns = (reading.length[leg] - of.offset[leg]) / of.m_per_turn[leg]
    return turns, rate / of.m_per_turn[leg], loss * force / of.N_per_Nm[leg]


@helper
def put_message(messages: int, count: int, leg: int, kind: int, mode: int, counter: int, force: float) -> int:
    """Put a message to one leg behind `count` elements of MESSAGE at an address; return their number."""
    message = message_at(messages + count * _MESSAGE)
    message.kind, message.mode, message.counter, message.count = kind, mode, counter, 1
    message.legs[0], message.force[0] = leg, force
    return count + 1


class DrivesEnd:
    """The drives' end of a family. Mutable state: what six drives remember, powered up to begin with.

    And the messages of the last frame, good until the next one.

    Three functions go by address: ``parse(context, frame, messages)`` -> how many messages it fills in, or
    FAILED to leave the frame to `converse`; ``answer(context, sync, reading, frames, legs)`` -> how many
    frames, with the leg of each, or FAILED for what is not a number; ``report(context, leg, state, fault,
    watchdog or -1 before the drive is set up, reaction, due, frames)`` -> how many frames. All arguments are
    integers: addresses of FRAME, MESSAGE, READING and int64, and numbers; the watchdog in ns; due: 1 at a
    heartbeat, 0 at a change.
    """

    def __init__(self, record: Rows, parse: Pointed, answer: Pointed, report: Pointed) -> None:
        """Take what the three functions work on: it has what the drives remember, or where that is."""
        self.record = self.state = record
        self.parse, self.answer, self.report = parse, answer, report
        self.messages, self._frames = np.zeros(MOST_MESSAGES, MESSAGE), np.zeros(MOST_MESSAGES, FRAME)
        self._count = 0

    def converse(self, frame: Frame) -> None:
        """Take what is not compiled, with `put` and `say`: a set-up, a question who is there, a stop."""
        raise NotImplementedError

    def put(
        self, kind: int, legs: Sequence[int] = (), mode: int = 0, counter: int = 0, force: float = 0.0
    ) -> None:
        """Put a message behind those of the present frame."""
        message: Any = self.messages[self._count]
        message["kind"], message["mode"] = kind, mode
        message["counter"], message["count"] = counter, len(legs)
        message["legs"][: len(legs)], message["force"] = legs, force
        self._count += 1

    def say(self, leg: int, frame: Frame) -> None:
        """Let a drive send its own part of a dialogue."""
        into = self._frames[self._count :]
        into[:1] = sent_array([frame])
        self.put(ANSWER, (leg,), counter=data_at(into))

    def hear(self, frame: Frame) -> Rows:
        """Return the messages to drives in a frame; none when it addresses none of them."""
        self._count = self.parse(self.record, sent_array([frame]), self.messages)
        if self._count == FAILED:
            self._count = 0
            self.converse(frame)
        return self.messages[: self._count]

    def announce(self, leg: int, state: int, fault: int = 0) -> tuple[Frame, ...]:
        """Frames that a drive sends at its heartbeat before it is set up."""
        count = self.report(self.record, leg, state, fault, -1, 0, 1, self._frames)
        return sent_frames(self._frames[:count])

    def restart(self, legs: Sequence[int]) -> None:
        """Forget what drives remember that were switched off and on: nothing, where their state tells."""
