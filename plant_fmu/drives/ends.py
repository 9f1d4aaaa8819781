"""The drives' end of a family: what the emulated drives call, and the records that go between."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import FAILED, Pointed, data_at, record_at
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.protocol import Frame
from drivers.signals import LEGS, Reaction
from drivers.tick_columns import Record
from drivers.transmission import loss_of
from plant_fmu import messages as m

SYNC, COMMAND, UNWATCHED, ALIVE, CONFIGURE, REJECTED, STOP, OTHER = range(8)
"""Kinds of a message; STOP and OTHER are for the owner of the pass."""
MESSAGE = np.dtype(
    [
        *((name, "<i8") for name in ("kind", "mode", "counter", "count")),
        ("legs", "<i8", (LEGS,)),
        ("force", "<f8", (LEGS,)),
    ]
)
"""A `DeviceMessage`: its first `count` legs, and of a command the force for each, N.

Of a CONFIGURE `mode` is the reaction, `counter` the watchdog in ns; of a REJECTED `mode` says why."""
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


class DrivesEnd(ABC):
    """The drives' end of a family. Mutable state: what six drives remember; powered up to begin with.

    For compiled passes the same by address, 0 where there is none: ``parse(context, frame, messages)`` ->
    how many messages it fills in; ``answer(context, sync, reading, frames, legs)`` -> how many frames, with
    the leg of each; ``report(context, leg, state, fault, watchdog or -1 before the drive is set up, reaction,
    due, frames)`` -> how many frames. All arguments are integers: addresses of FRAME, MESSAGE, READING and
    int64, and numbers; the watchdog in ns. FAILED leaves it to `hear`, `reply` and `announce`.
    """

    parse = answer = report = context = 0

    @abstractmethod
    def hear(self, frame: Frame) -> tuple[m.DeviceMessage, ...]:
        """Messages to the drives in a frame; empty when it addresses none of them."""

    @abstractmethod
    def reply(self, sync: m.Sync, reading: Record) -> list[tuple[int, Frame]]:
        """Answers of the drives of `sync.legs` to a reading, an element of READING: frames with their legs.

        Raises ProtocolError on NaN.
        """

    @abstractmethod
    def announce(self, status: m.Status) -> tuple[Frame, ...]:
        """Frames that report a drive's state, at its heartbeat and at each change."""

    @abstractmethod
    def restart(self, legs: Sequence[int]) -> None:
        """Forget what drives remember that were switched off and on, where their state does not tell."""


def device_message(kind: int, mode: int, counter: int, count: int, at: Ints, force: Array) -> m.DeviceMessage:
    """Return an element of MESSAGE as a DeviceMessage; force (6,) N."""
    legs = tuple(at[:count].tolist())
    if kind == SYNC:
        return m.Sync(counter, legs)
    if kind in (COMMAND, UNWATCHED):
        made = m.DeviceCommand if kind == COMMAND else m.UnwatchedCommand
        return made(legs, mode, np.array(force[:count]), counter)
    if kind == ALIVE:
        return m.Alive(legs)
    if kind == CONFIGURE:
        return m.Configure(legs[0], counter / 1e9, Reaction(mode))
    return m.EmergencyStop(legs)


MOST_MESSAGES, MOST_ANSWERS = 64, 4 * LEGS
"""Of one frame, and to one SYNC, at an end that is compiled."""


class CompiledDrives(DrivesEnd):
    """A `DrivesEnd` that is compiled. Mutable state: what the drives remember, in `state`."""

    def __init__(self, record: Rows, parse: Pointed, answer: Pointed, report: Pointed) -> None:
        self.record = self.state = record
        self._parse, self._answer, self._report = parse, answer, report
        self.parse, self.answer, self.report = parse.address, answer.address, report.address
        self.context = data_at(record)
        self._messages = np.zeros(MOST_MESSAGES, MESSAGE)
        self._frames, self._legs = np.zeros(MOST_ANSWERS, FRAME), np.zeros(MOST_ANSWERS, np.int64)

    def reason(self, why: int, counter: int, number: float, frame: Frame) -> str:
        """Return why a frame is rejected: what its message has as mode, counter and first force."""
        raise NotImplementedError

    def converse(self, frame: Frame) -> tuple[m.DeviceMessage, ...]:
        """Decode what is not compiled: what sets drives up, asks who they are or stops them."""
        raise NotImplementedError

    def hear(self, frame: Frame) -> tuple[m.DeviceMessage, ...]:
        """Messages to the drives in a frame; empty when it addresses none of them."""
        count = self._parse(self.record, sent_array([frame]), self._messages)
        if count == FAILED:
            return self.converse(frame)
        return tuple(self._message(each, frame) for each in self._messages[:count].tolist())

    def _message(self, message: Any, frame: Frame) -> m.DeviceMessage:
        kind, mode, counter, _, _, force = message
        if kind == REJECTED:
            return m.Rejected(self.reason(mode, counter, force[0], frame))
        return device_message(*message)

    def reply(self, sync: m.Sync, reading: Record) -> list[tuple[int, Frame]]:
        """Answers of the drives of `sync.legs`, see `DrivesEnd.reply`."""
        put_messages([sync], self._messages)
        count = self._answer(self.record, self._messages, reading, self._frames, self._legs)
        if count == FAILED:
            length, rate, force = (reading[name] for name in ("length", "rate", "force"))
            leg = int((~np.isfinite(length + rate + force)).argmax())
            raise ProtocolError(
                f"feedback of leg {leg} is not a number: {length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
            )
        return list(zip(self._legs[:count].tolist(), sent_frames(self._frames[:count]), strict=True))

    def announce(self, status: m.Status) -> tuple[Frame, ...]:
        """Frames that report a drive's state, at its heartbeat and at each change."""
        leg, state, fault, holds, due = status
        watchdog_ns, reaction = (-1, 0) if holds is None else (round(holds.watchdog_s * 1e9), holds.reaction)
        given = (leg, state, fault, watchdog_ns, int(reaction), int(due))
        return sent_frames(self._frames[: self._report(self.record, *given, self._frames)])

    def restart(self, legs: Sequence[int]) -> None:
        """Forget nothing: the state of a drive tells."""


_KINDS = {
    m.Sync: SYNC,
    m.DeviceCommand: COMMAND,
    m.UnwatchedCommand: UNWATCHED,
    m.Alive: ALIVE,
    m.Configure: CONFIGURE,
    m.Rejected: REJECTED,
    m.EmergencyStop: STOP,
}


def put_messages(messages: Sequence[m.DeviceMessage], into: Rows) -> None:
    """Fill elements of MESSAGE with messages; any other kind becomes OTHER."""
    for k, message in enumerate(messages):
        each: Any = into[k]
        each["kind"] = _KINDS.get(type(message), OTHER)
        if isinstance(message, m.Sync | m.Alive | m.DeviceCommand | m.EmergencyStop):
            count = each["count"] = len(message.legs)
            each["legs"][:count] = message.legs
        if isinstance(message, m.Sync | m.DeviceCommand):
            each["counter"] = message.counter
        if isinstance(message, m.DeviceCommand):
            each["mode"] = message.mode
            each["force"][:count] = message.force
        if isinstance(message, m.Configure):
            each["count"], each["legs"][0] = 1, message.leg
            each["counter"], each["mode"] = round(message.watchdog_s * 1e9), message.reaction
