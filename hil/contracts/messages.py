"""What six emulated drives hear and send, as values that can be compared: `plant_fmu.drives.ends` has records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, array_at
from drivers.compiled.pointed import FAILED
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME, sent_frames
from drivers.protocol import ALL_LEGS, Frame
from drivers.signals import Reaction
from plant_fmu.drives import ends
from plant_fmu.drives.ends import MESSAGE, DrivesEnd


class Sync(NamedTuple):
    """The drives of `legs` latch their encoders and answer."""

    counter: int
    legs: tuple[int, ...] = ALL_LEGS


class DeviceCommand(NamedTuple):
    """A command: force N, one for each of `legs`."""

    legs: tuple[int, ...]
    mode: int
    force: Array
    counter: int


class UnwatchedCommand(DeviceCommand):
    """A command that does not feed the drives' watchdogs."""


class Alive(NamedTuple):
    """What those watchdogs wait for."""

    legs: tuple[int, ...] = ALL_LEGS


class Configure(NamedTuple):
    """Set-up of one drive."""

    leg: int
    watchdog_s: float
    reaction: Reaction


class EmergencyStop(NamedTuple):
    """The drives of `legs` fault at once."""

    legs: tuple[int, ...] = ALL_LEGS


class Answer(NamedTuple):
    """A drive's own part of the start-up dialogue."""

    leg: int
    frame: Frame


@dataclass(frozen=True)
class Rejected:
    """A frame of ours that cannot be trusted."""


DeviceMessage = Sync | DeviceCommand | Alive | Configure | EmergencyStop | Answer | Rejected


class Status(NamedTuple):
    """What a drive is in."""

    leg: int
    state: int
    fault: int
    set_up: Configure | None = None
    due: bool = True


def message_of(record: Any) -> DeviceMessage:
    """Return an element of MESSAGE as a value."""
    kind, mode, counter, count, at, force = record.tolist()
    legs = tuple(at[:count])
    match kind:
        case ends.SYNC:
            return Sync(counter, legs)
        case ends.COMMAND | ends.UNWATCHED:
            made = DeviceCommand if kind == ends.COMMAND else UnwatchedCommand
            return made(legs, mode, np.array(force[:count]), counter)
        case ends.ALIVE:
            return Alive(legs)
        case ends.CONFIGURE:
            return Configure(legs[0], counter / 1e9, Reaction(mode))
        case ends.STOP:
            return EmergencyStop(legs)
        case ends.ANSWER:
            return Answer(legs[0], sent_frames(array_at(counter, 1, FRAME))[0])
    return Rejected()


def hear(end: DrivesEnd, frame: Frame) -> tuple[DeviceMessage, ...]:
    """Messages to the drives in a frame."""
    return tuple(message_of(each) for each in end.hear(frame))


def reply(end: DrivesEnd, sync: Sync, reading: Any) -> list[tuple[int, Frame]]:
    """Answers of the drives of a SYNC to a reading, frames with their legs. Raises ProtocolError on NaN."""
    asked: Any = np.zeros((), MESSAGE)
    asked["kind"], asked["counter"], asked["count"] = ends.SYNC, sync.counter, len(sync.legs)
    asked["legs"][: len(sync.legs)] = sync.legs
    frames, legs = np.zeros(ends.MOST_MESSAGES, FRAME), np.zeros(ends.MOST_MESSAGES, np.int64)
    count = end.answer(end.record, asked, reading, frames, legs)
    if count == FAILED:
        raise ProtocolError("what a drive reads is not a number")
    return list(zip(legs[:count].tolist(), sent_frames(frames[:count]), strict=True))


def announce(end: DrivesEnd, status: Status) -> tuple[Frame, ...]:
    """Frames that report the state of a drive."""
    leg, state, fault, holds, due = status
    held = (-1, 0) if holds is None else (round(holds.watchdog_s * 1e9), int(holds.reaction))
    into = np.zeros(ends.MOST_MESSAGES, FRAME)
    return sent_frames(into[: end.report(end.record, leg, state, fault, *held, int(due), into)])
