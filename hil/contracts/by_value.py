"""Both ends of a protocol as pure functions: each call takes the state of an end and gives the next state.

A test can therefore restore a state, repeat a call, or compare the states after two sequences of frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.controller_end import ControllerEnd
from drivers.frame_array import sent_frames
from drivers.protocol import ALWAYS, DriveSetup, Frame
from drivers.signals import Command
from drivers.tick_columns import Record
from hil.contracts.drives_end import go_back, memory_of, reading_of
from hil.contracts.messages import DeviceMessage, Status, Sync, announce, hear, reply
from plant_fmu.drives import drives_end
from plant_fmu.drives.codec import DrivesEnd


class Remembered:
    """State of one end of a drive protocol: the fields of its record, as tuples where they are arrays."""

    def __init__(self, state: Any, setup: DriveSetup | None = None, first: str | None = None) -> None:
        """Store the state; of a controller's end also its set-up and the first field that `==` compares."""
        self.state, self.setup, self.first = state, setup, first

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "state":
            raise AttributeError(name)
        if not isinstance(self.state, np.ndarray):
            return getattr(self.state, name)
        value = self.state[name].tolist()
        return tuple(value) if isinstance(value, list) else value

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Remembered) or not isinstance(self.state, np.ndarray):
            return isinstance(other, Remembered) and self.__reduce__() == other.__reduce__()
        names = list(self.state.dtype.names or ())
        names = [name for name in names[names.index(self.first or names[0]) :] if name != "scratch"]
        alike = (self.state[name].tobytes() == other.state[name].tobytes() for name in names)
        return self.setup == other.setup and all(alike)

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> Any:
        return type(self), (self.state, self.setup, self.first)

    def _replace(self, **values: Any) -> Remembered:
        """Copy of the state in which the given fields have other values."""
        if not isinstance(self.state, np.ndarray):
            return type(self)(self.state._replace(**values), self.setup)
        state = self.state.copy()
        for name, value in values.items():
            state[name] = value
        return type(self)(state, self.setup, self.first)


class ByValue:
    """A drive protocol whose controller's end and drives' end are pure functions of their state."""

    def __init__(self, protocol: Any) -> None:
        self.protocol = protocol
        self._controllers: dict[DriveSetup, ControllerEnd] = {}
        self._drives: DrivesEnd | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "protocol":
            raise AttributeError(name)
        return getattr(self.protocol, name)

    @staticmethod
    def of(protocol: Any) -> ByValue:
        """Protocol as a ByValue; a protocol that is one already is returned unchanged."""
        return protocol if isinstance(protocol, ByValue) else ByValue(protocol)

    # controller's end

    def start(self, setup: DriveSetup) -> Remembered:
        """State of the controller's end before its first frame."""
        end = self._controllers[setup] = self.protocol.controller_end(setup)
        return self._dialogue(end, setup)

    def _dialogue(self, end: ControllerEnd, setup: DriveSetup | None) -> Remembered:
        return Remembered(end.remembered(), setup, getattr(end, "first", None))

    def _end(self, dialogue: Remembered) -> ControllerEnd:
        assert dialogue.setup is not None
        if dialogue.setup not in self._controllers:
            self.start(dialogue.setup)
        end = self._controllers[dialogue.setup]
        end.remember(dialogue.state)
        return end

    def begin(self, dialogue: Remembered, tick: int) -> tuple[Frame, ...]:
        """Frames that the controller sends at the start of a tick, such as SYNC."""
        return sent_frames(self._end(dialogue).begin(tick))

    def decode(
        self, dialogue: Remembered, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> Remembered:
        """Fill the measurement columns of `tick` from frames; return the controller's next state."""
        end = self._end(dialogue)
        end.take(frames, last, tick, since_ns)
        return self._dialogue(end, dialogue.setup)

    def command(
        self, dialogue: Remembered, command: Command, tick: int
    ) -> tuple[Remembered, tuple[Frame, ...]]:
        """Next state of the controller's end, and the frames that carry the command of a tick."""
        end = self._end(dialogue)
        frames = sent_frames(end.give(command, tick))
        return self._dialogue(end, dialogue.setup), frames

    def set_up(self, dialogue: Remembered, tick: Record) -> tuple[Remembered, tuple[Frame, ...]]:
        """Next state of the controller's end, and its frames of the start-up dialogue in a tick."""
        end = self._end(dialogue)
        frames = sent_frames(end.set_up(tick))
        return self._dialogue(end, dialogue.setup), frames

    def legs_set_up(self, dialogue: Remembered) -> tuple[bool, ...]:
        """For each of the six drives: True if the controller has confirmed its set-up."""
        return self._end(dialogue).legs_set_up()

    def set_up_lacks(self, dialogue: Remembered) -> tuple[str, ...]:
        """For each drive a text that lists the set-up it has not confirmed; "" if nothing is missing."""
        return self._end(dialogue).lacks()

    def carried(self, dialogue: Remembered, force: Array) -> Array:
        """Forces (6,) N that legs at rest get if the command is `force` (6,) N, as the protocol rounds it."""
        return self._end(dialogue).carried(force)

    # drives' end

    def power_up(self) -> Remembered:
        """State of six drives just switched on, before any frame."""
        self._drives = drives_end(self.protocol)
        return self._memory(self._drives)

    def _memory(self, end: DrivesEnd) -> Remembered:
        return Remembered(memory_of(end))

    def _at(self, memory: Remembered) -> DrivesEnd:
        if self._drives is None:
            self.power_up()
        assert self._drives is not None
        go_back(self._drives, memory.state)
        return self._drives

    def parse(self, memory: Remembered, frame: Frame) -> tuple[Remembered, tuple[DeviceMessage, ...]]:
        """Next state of the drives, and the messages that they decode from a frame."""
        end = self._at(memory)
        messages = hear(end, frame)
        return self._memory(end), messages

    def answer(
        self,
        memory: Remembered,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[Remembered, list[tuple[int, Frame]]]:
        """Next state of the drives, and their answers to a SYNC as (leg, frame), for readings (6,)."""
        end = self._at(memory)
        frames = reply(end, sync, reading_of(length, rate, force, state, 0 if fault is None else fault))
        return self._memory(end), frames

    def report(self, memory: Remembered, status: Status) -> tuple[Remembered, tuple[Frame, ...]]:
        """Next state of the drives, and the frames in which one drive reports its status."""
        end = self._at(memory)
        frames = announce(end, status)
        return self._memory(end), frames

    def restarted(self, memory: Remembered, legs: Sequence[int]) -> Remembered:
        """State of the drives after those of `legs` were switched off and on."""
        end = self._at(memory)
        end.restart(legs)
        return self._memory(end)
