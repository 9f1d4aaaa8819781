"""Both ends of a drive family by address: what compiled passes call, and the records that go between.

A protocol returns a `DrivesEnd` from `drives_end()`. A `Family` has both ends compiled, and returns a
`CompiledDrives`.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, Pointed, data_at, of_python, record_at
from drivers.controller_end import array_at
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME, received_array, received_frames, sent_array, sent_frames
from drivers.protocol import (
    ALL_LEGS,
    BUS,
    Alive,
    Configure,
    DeviceCommand,
    DeviceMessage,
    DriveProtocol,
    EmergencyStop,
    Frame,
    Received,
    Rejected,
    Status,
    Sync,
    UnwatchedCommand,
)
from drivers.signals import LEGS, Reaction

SYNC, COMMAND, UNWATCHED, ALIVE, CONFIGURE, REJECTED, STOP, OTHER = range(8)
"""Kinds of a message; STOP, which an end in the pass leaves to the protocol, and OTHER are for its owner."""
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
"""What six drives read, as `DrivesEnd.reply` takes it."""
_MESSAGE = MESSAGE.itemsize
frame_at: Any = record_at(record(FRAME))
message_at: Any = record_at(record(MESSAGE))
reading_at: Any = record_at(record(READING))


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
    def hear(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Return what a frame says to the drives; no messages when it is not for them."""

    @abstractmethod
    def reply(
        self, sync: Sync, length: Array, rate: Array, force: Array, state: Ints, fault: Ints | None = None
    ) -> list[tuple[int, Frame]]:
        """Return what the drives of `sync.legs` answer, each frame with its leg.

        length m, rate m/s, force N, each (6,); state (6,) DriveState, plus INVALID where length and rate are
        of no use; fault (6,) DriveFault, for protocols whose feedback names it. Raises ProtocolError on NaN.
        """

    @abstractmethod
    def announce(self, status: Status) -> tuple[Frame, ...]:
        """Return what a drive sends of what it is in, at its heartbeat and at each change."""

    @abstractmethod
    def restart(self, legs: Sequence[int]) -> None:
        """Forget what drives remember that were switched off and on, where their state does not tell."""

    @abstractmethod
    def remembered(self) -> Any:
        """Return a copy of what the drives remember, for `remember`."""

    @abstractmethod
    def remember(self, memory: Any) -> None:
        """Go back to what was `remembered`."""


def drives_end(protocol: DriveProtocol) -> DrivesEnd:
    """Return the drives' end of a protocol, powered up."""
    return cast("DrivesEnd", protocol.drives_end())


def device_message(kind: int, mode: int, counter: int, count: int, at: Ints, force: Array) -> DeviceMessage:
    """Return an element of MESSAGE as a DeviceMessage; force (6,) N."""
    legs = tuple(at[:count].tolist())
    if kind == SYNC:
        return Sync(counter, legs)
    if kind in (COMMAND, UNWATCHED):
        made = DeviceCommand if kind == COMMAND else UnwatchedCommand
        return made(legs, mode, np.array(force[:count]), counter)
    if kind == ALIVE:
        return Alive(legs)
    if kind == CONFIGURE:
        return Configure(legs[0], counter / 1e9, Reaction(mode))
    return EmergencyStop(legs)


MOST_MESSAGES, MOST_ANSWERS = 32, 4 * LEGS
"""Of one frame, and to one SYNC, at an end that is compiled."""


class CompiledDrives(DrivesEnd):
    """A `DrivesEnd` that is compiled. Mutable state: what the drives remember, in `state`."""

    def __init__(self, record: Rows, parse: Pointed, answer: Pointed, report: Pointed) -> None:
        self.record = self.state = record
        self._parse, self._answer, self._report = parse, answer, report
        self.parse, self.answer, self.report = parse.address, answer.address, report.address
        self.context = data_at(record)
        self._messages, self._reading = np.zeros(MOST_MESSAGES, MESSAGE), np.zeros((), READING)
        self._frames, self._legs = np.zeros(MOST_ANSWERS, FRAME), np.zeros(MOST_ANSWERS, np.int64)

    def reason(self, why: int, counter: int, number: float, frame: Frame) -> str:
        """Return why a frame is rejected: what its message has as mode, counter and first force."""
        raise NotImplementedError

    def converse(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Decode what is not compiled: what sets drives up, asks who they are or stops them."""
        raise NotImplementedError

    def hear(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Return what a frame says to the drives; no messages when it is not for them."""
        count = self._parse(self.record, sent_array([frame]), self._messages)
        if count == FAILED:
            return self.converse(frame)
        return tuple(self._message(each, frame) for each in self._messages[:count].tolist())

    def _message(self, message: Any, frame: Frame) -> DeviceMessage:
        kind, mode, counter, _, _, force = message
        return (
            Rejected(self.reason(mode, counter, force[0], frame))
            if kind == REJECTED
            else device_message(*message)
        )

    def reply(
        self, sync: Sync, length: Array, rate: Array, force: Array, state: Ints, fault: Ints | None = None
    ) -> list[tuple[int, Frame]]:
        """Return what the drives of `sync.legs` answer, each frame with its leg; see `DrivesEnd.reply`."""
        self._reading[()] = length, rate, force, state, 0 if fault is None else fault
        put_messages([sync], self._messages)
        count = self._answer(self.record, self._messages, self._reading, self._frames, self._legs)
        if count == FAILED:
            leg = int((~np.isfinite(length + rate + force)).argmax())
            raise ProtocolError(
                f"feedback of leg {leg} is not a number: {length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
            )
        return list(zip(self._legs[:count].tolist(), sent_frames(self._frames[:count]), strict=True))

    def announce(self, status: Status) -> tuple[Frame, ...]:
        """Return what a drive sends of what it is in, at its heartbeat and at each change."""
        leg, state, fault, holds, due = status
        watchdog_ns, reaction = (-1, 0) if holds is None else (round(holds.watchdog_s * 1e9), holds.reaction)
        given = (leg, state, fault, watchdog_ns, int(reaction), int(due))
        return sent_frames(self._frames[: self._report(self.record, *given, self._frames)])

    def restart(self, legs: Sequence[int]) -> None:
        """Forget nothing: the state of a drive tells."""

    def remembered(self) -> Rows:
        """Return a copy of what the drives remember, for `remember`."""
        return self.state.copy()

    def remember(self, memory: Rows) -> None:
        """Go back to what was `remembered`."""
        self.state[...] = memory


class Hearing(NamedTuple):
    """What the controller's end makes of frames, by address."""

    fresh: int
    """(context, frame, tick, since_ns) -> the place in `wanted` of a frame that is `fresh`, from 1 on; 0 for
    one that is not."""
    addressed: int
    """(context, frame) -> bit i: a frame is for leg i."""
    context: int
    wanted: tuple[int, ...]
    """`DriveProtocol.feedback_ids`."""
    keeps: Any


class Family(DriveProtocol):
    """What the codecs of all families share: each frame goes on the bus of the leg that it is for.

    Holds tables only. A drive's frame counts on its own bus alone.
    """

    fresh_by: Pointed
    """`Hearing.fresh`, of the record of the drives' end."""
    addressed_by: Pointed
    """`Hearing.addressed`, of the same."""
    wanted: tuple[int, ...]
    """`feedback_ids`, in an order."""
    senders: Mapping[int, int]
    """Identifier -> the leg whose drive sends it."""

    def __init__(self, legs: Sequence[Sequence[int]] = (ALL_LEGS,)) -> None:
        """Take the legs of each bus, which together are all legs, each once."""
        self.legs = tuple(map(tuple, legs))
        self.buses = len(legs) if len(legs) > 1 else 0
        """How many there are; 0: one, and frames of others are nobody's."""
        self.bus_of = tuple(next(bus for bus, own in enumerate(legs) if leg in own) for leg in range(LEGS))
        """Index of each leg's bus."""

    @cached_property
    def _hears(self) -> Rows:
        return cast("CompiledDrives", drives_end(self)).record

    def hearing(self) -> Hearing:
        """Return the controller's end by address, as far as it hears."""
        by = self.fresh_by.address, self.addressed_by.address
        return Hearing(*by, data_at(self._hears), self.wanted, self)

    def to_leg(self, leg: int, frame: Frame) -> Frame:
        """Return a frame on the bus of a leg."""
        return frame._replace(flags=frame.flags % BUS + BUS * self.bus_of[leg])

    def to_each(self, frames: Iterable[Frame]) -> tuple[Frame, ...]:
        """Return frames for the drives, leg order, each on the bus of its leg."""
        return tuple(self.to_leg(leg, frame) for leg, frame in enumerate(frames))

    def to_all(self, frame: Frame) -> tuple[Frame, ...]:
        """Return a frame that is for all drives, on each bus."""
        return tuple(frame._replace(flags=frame.flags + BUS * bus) for bus in sorted(set(self.bus_of)))

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is feedback of this tick that can be trusted."""
        return self.fresh_by(self._hears, received_array([received]), tick, since_ns) > 0

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame of the controller's end is for."""
        legs = self.addressed_by(self._hears, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame on its own bus, -1 for any other frame."""
        leg = self.senders.get(frame.id, -1)
        return leg if leg >= 0 and self.bus_of[leg] == frame.bus else -1


def hearing(protocol: DriveProtocol) -> Hearing:
    """Return the controller's end of a protocol, as far as it hears."""
    compiled = getattr(protocol, "hearing", None)
    return _python_hearing(protocol) if compiled is None else cast("Hearing", compiled())


def _python_hearing(protocol: DriveProtocol) -> Hearing:
    wanted = tuple(sorted(protocol.traits.feedback_ids))
    places = {each: place for place, each in enumerate(wanted, 1)}

    def fresh(_context: int, frame: int, tick: int, since_ns: int) -> int:
        (received,) = received_frames(array_at(frame, 1, FRAME))
        if not protocol.fresh(received, tick, since_ns):
            return 0
        return places.get(protocol.awaited(received.frame), len(wanted) + 1)

    def addressed(_context: int, frame: int) -> int:
        (received,) = received_frames(array_at(frame, 1, FRAME))
        return sum(1 << leg for leg in protocol.addressed(received.frame))

    looks, keeps_fresh = of_python(fresh, *[INTEGER] * 4)
    asks, keeps_addressed = of_python(addressed, *[INTEGER] * 2)
    return Hearing(looks, asks, 0, wanted, (keeps_fresh, keeps_addressed))


_KINDS = {
    Sync: SYNC,
    DeviceCommand: COMMAND,
    UnwatchedCommand: UNWATCHED,
    Alive: ALIVE,
    Configure: CONFIGURE,
    Rejected: REJECTED,
}


def put_messages(messages: Sequence[DeviceMessage], into: Rows) -> None:
    """Fill elements of MESSAGE with messages; what is none of the kinds here is OTHER."""
    for k, message in enumerate(messages):
        each: Any = into[k]
        each["kind"] = _KINDS.get(type(message), OTHER)
        if isinstance(message, Sync | Alive | DeviceCommand):
            count = each["count"] = len(message.legs)
            each["legs"][:count] = message.legs
        if isinstance(message, Sync | DeviceCommand):
            each["counter"] = message.counter
        if isinstance(message, DeviceCommand):
            each["mode"] = message.mode
            each["force"][:count] = message.force
        if isinstance(message, Configure):
            each["count"], each["legs"][0] = 1, message.leg
            each["counter"], each["mode"] = round(message.watchdog_s * 1e9), message.reaction
