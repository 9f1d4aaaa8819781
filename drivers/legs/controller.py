"""The controller's end of the own protocol, compiled: its dialogue, and the codec's record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.compiled.pointed import FAILED, data_at
from drivers.controller_end import ControllerEnd
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.legs import kernels
from drivers.legs.set_up import NOT_HEARD
from drivers.protocol import DriveProtocol, DriveSetup, Frame
from drivers.signals import LEGS, Command
from drivers.tick_columns import Record


class LegsDialogue(NamedTuple):
    """What the controller's end remembers."""

    configure: tuple[Frame, ...]
    """CONFIG of each drive."""
    expected: bytes
    """What the status of each drive that is set up says of its set-up, two bytes each."""
    interval: int
    """Ticks from one CONFIG of a drive to its next."""
    sent: tuple[int, ...]
    """How often each drive has been sent its CONFIG."""
    confirmed: int = 0
    """Bit i: the last status of drive i has confirmed its set-up."""
    said: tuple[int, ...] = (NOT_HEARD,) * LEGS
    """What the last status of each drive that has not confirmed its set-up says of it."""


def codec_of(
    tables: tuple[Ints, Ints, Array],
    rows: Sequence[tuple[list[int], Array]],
    buses: int,
    bus_of: Sequence[int],
) -> tuple[Record, Any]:
    """Return a record of `kernels.CODEC`, and the arrays that it points to.

    tables: identifiers, form and scale of `decode`; rows: form and steps of each command frame.
    """
    identifiers, form, scale = tables
    forms = np.array([each for each, _ in rows], np.int64).reshape(len(rows), kernels.COMMAND_FORM)
    steps = np.array([each for _, each in rows], float)
    codec = np.zeros((), kernels.CODEC)
    codec["identifiers"], codec["known"] = data_at(identifiers), len(identifiers)
    codec["form"], codec["scale"] = form, scale
    codec["buses"], codec["bus_of"] = buses, bus_of
    codec["commands"], codec["steps"], codec["frames"] = data_at(forms), data_at(steps), len(rows)
    return codec, (forms, steps, identifiers)


def encoded(codec: Record, command: Command, tick: int) -> tuple[Frame, ...]:
    """Return the frames of a command; none where a force does not fit."""
    into, force = np.empty(int(codec["frames"]), FRAME), np.ascontiguousarray(command.force, float)
    if force.shape != (LEGS,):
        return ()
    sent = kernels.command(codec, tick, int(command.mode), 0, data_at(force), data_at(into))
    return () if sent == FAILED else sent_frames(into)


def decoded(
    codec: Record,
    dialogue: LegsDialogue,
    frames: Rows,
    last: Record,
    tick: Record,
    since_ns: int,
    heard: Callable[[tuple[int, ...], Rows], tuple[int, ...]],
) -> LegsDialogue:
    """Return the dialogue after the frames of a tick, whose measurement is filled."""
    own = codec.copy()
    own["expected"] = np.frombuffer(dialogue.expected, np.uint8)
    own["confirmed"] = dialogue.confirmed
    if not kernels.decode(own, data_at(frames), len(frames), since_ns, last, tick):
        return dialogue
    return dialogue._replace(confirmed=int(own["confirmed"]), said=heard(dialogue.said, frames))


class LegsController(ControllerEnd):
    """The controller's end, compiled. The codec's record has what the drives have confirmed."""

    def __init__(
        self, protocol: LegsFamily, setup: DriveSetup, codec: Record, syncs: Sequence[Sequence[Frame]]
    ) -> None:
        """Take the family's tables, which are copied, and its SYNC of each counter."""
        self._family, self._own = protocol, codec.copy()
        self._syncs = [sent_array(each) for each in syncs]
        super().__init__(protocol, setup)
        self.codec = data_at(self._own)

    def _functions(self) -> tuple[int, int, Any]:
        return kernels.decode.address, kernels.command.address, (self._own, self._family)

    def start(self) -> None:
        """Begin the dialogue: no drive has been set up."""
        super().start()
        self._own["expected"] = np.frombuffer(self.dialogue.expected, np.uint8)
        self._own["confirmed"] = 0

    def begin(self, number: int) -> Rows:
        """Return SYNC."""
        return self._syncs[number & 0xFF]

    def look(self, frames: Rows) -> None:
        """Take in what the drives say of their set-up."""
        said = self._family.heard(self.dialogue.said, frames)
        self.dialogue = self.dialogue._replace(confirmed=int(self._own["confirmed"]), said=said)


class LegsFamily(DriveProtocol, Protocol):
    """Our own protocol on one bus or several."""

    def heard(self, said: tuple[int, ...], frames: Rows) -> tuple[int, ...]:
        """Return what the drives have said of their set-up, with the statuses of a tick."""
