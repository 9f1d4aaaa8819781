"""Messages of six emulated drives as comparable values; `plant_fmu.drives.codec` has the records."""

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
from plant_fmu.drives import codec as ends
from plant_fmu.drives.codec import MESSAGE, DrivesEnd


class Sync(NamedTuple):
    """SYNC: the drives of `legs` sample their encoders and answer."""

    counter: int
    legs: tuple[int, ...] = ALL_LEGS


class DeviceCommand(NamedTuple):
    """Command to drives: mode, and one force, N, > 0 extends, for each of `legs`."""

    legs: tuple[int, ...]
    mode: int
    force: Array
    counter: int


class UnwatchedCommand(DeviceCommand):
    """Command that does not reset the drives' watchdogs."""


class Alive(NamedTuple):
    """Message that resets the watchdogs of the drives of `legs`."""

    legs: tuple[int, ...] = ALL_LEGS


class Configure(NamedTuple):
    """Message that sets the watchdog time and the reaction of one drive."""

    leg: int
    watchdog_s: float
    reaction: Reaction


class EmergencyStop(NamedTuple):
    """Emergency stop: the drives of `legs` fault at once."""

    legs: tuple[int, ...] = ALL_LEGS


class Answer(NamedTuple):
    """Frame with which a drive answers in the start-up dialogue."""

    leg: int
    frame: Frame


@dataclass(frozen=True)
class Rejected:
    """A frame with an identifier of the protocol and invalid content."""


DeviceMessage = Sync | DeviceCommand | Alive | Configure | EmergencyStop | Answer | Rejected


class Status(NamedTuple):
    """Status that a drive reports: state, fault code, its set-up if it has one; due: at a heartbeat."""

    leg: int
    state: int
    fault: int
    set_up: Configure | None = None
    due: bool = True


def message_of(record: Any) -> DeviceMessage:
    """Message to the drives as a value that can be compared, from a record of MESSAGE."""
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
    """Messages that the drives' end decodes from a frame."""
    return tuple(message_of(each) for each in end.hear(frame))


def reply(end: DrivesEnd, sync: Sync, reading: Any) -> list[tuple[int, Frame]]:
    """Answers of the drives to a SYNC, as frames with their legs. Raises ProtocolError for a nan reading."""
    request: Any = np.zeros((), MESSAGE)
    request["kind"], request["counter"], request["count"] = ends.SYNC, sync.counter, len(sync.legs)
    request["legs"][: len(sync.legs)] = sync.legs
    frames, legs = np.zeros(ends.MOST_MESSAGES, FRAME), np.zeros(ends.MOST_MESSAGES, np.int64)
    count = end.answer(end.record, request, reading, frames, legs)
    if count == FAILED:
        raise ProtocolError("the reading of a drive is not a number")
    return list(zip(legs[:count].tolist(), sent_frames(frames[:count]), strict=True))


def announce(end: DrivesEnd, status: Status) -> tuple[Frame, ...]:
    """Frames in which the drives' end reports the status of one drive."""
    leg, state, fault, holds, due = status
    held = (-1, 0) if holds is None else (round(holds.watchdog_s * 1e9), int(holds.reaction))
    into = np.zeros(ends.MOST_MESSAGES, FRAME)
    return sent_frames(into[: end.report(end.record, leg, state, fault, *held, int(due), into)])
