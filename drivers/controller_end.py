"""The controller's end of six drives: their dialogue, and a family's functions by address.

A compiled family gives an end of its own (`DriveProtocol.controller_end`); for any other the functions of its
`DriveProtocol` are called through the same addresses.
"""

import ctypes
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import FAILED, of_python
from drivers.frame_array import FRAME, sent_array
from drivers.protocol import Dialogue, DriveProtocol, DriveSetup
from drivers.signals import LEGS, Command, DriveMode
from drivers.tick_columns import TICK, Record

MOST_FRAMES = 64
"""Room for the frames of a command."""


def array_at(address: int, count: int, dtype: Any) -> Any:
    """Return `count` elements of a type at an address, from Python."""
    size = count * np.dtype(dtype).itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(address), dtype)


def tick_at(address: int) -> Record:
    """Return the record of a tick at an address, from Python."""
    return np.ndarray((), TICK, array_at(address, TICK.itemsize // 8, np.float64))


class ControllerEnd:
    """The dialogue with six drives, and what decodes their frames and encodes their command.

    ``decode(codec, frames, count, since_ns, last, tick)`` and ``command(codec, number, mode, stop, force,
    into)`` take addresses: of elements of FRAME, of records of TICK, of six forces in N. `decode` returns a
    status, > 0 where `look` has to be called; `command` the number of frames, FAILED where a force does not
    fit.

    Mutable state: the dialogue. `start` begins it anew.
    """

    def __init__(self, protocol: DriveProtocol, setup: DriveSetup) -> None:
        self.protocol, self._setup = protocol, setup
        self.codec = 0
        """Address of what the two functions work on."""
        self.decode, self.command, self._keeps = self._functions()
        self.error: BaseException | None = None
        """What a function in Python met, which returned FAILED."""
        self.start()

    def _functions(self) -> tuple[int, int, Any]:
        """Return the addresses of `decode` and `command`, and what keeps them."""
        decode, kept = of_python(self._decode, *[INTEGER] * 6)
        command, also = of_python(self._command, *[INTEGER] * 6)
        return decode, command, (kept, also)

    def start(self) -> None:
        """Begin the dialogue: no drive has been set up. Raises ProtocolError if the set-up does not fit."""
        self.dialogue: Dialogue = self.protocol.start(self._setup)
        self._set_up = self.protocol.legs_set_up(self.dialogue)

    def begin(self, number: int) -> Rows:
        """Return the frames that start a tick as elements of FRAME."""
        return sent_array(self.protocol.begin(self.dialogue, number))

    def set_up(self, tick: Record) -> Rows:
        """Return the start-up dialogue's frames of a tick as elements of FRAME."""
        self.dialogue, frames = self.protocol.set_up(self.dialogue, tick)
        return sent_array(frames)

    def look(self, frames: Rows) -> None:
        """Take in what a decoder leaves to Python: nothing here."""

    def refuse(self, force: Array, mode: DriveMode, number: int) -> None:
        """Raise the ProtocolError of a command that does not fit."""
        if self.error is not None:
            error, self.error = self.error, None
            raise error
        self.protocol.command(self.dialogue, Command(mode, force), number)

    def _decode(self, _codec: int, at: int, count: int, since_ns: int, last: int, tick: int) -> int:
        frames = array_at(at, count, FRAME) if count else sent_array(())
        try:
            decode = self.protocol.decode
            self.dialogue = decode(self.dialogue, frames, tick_at(last), tick_at(tick), since_ns)
            before, self._set_up = self._set_up, self.protocol.legs_set_up(self.dialogue)
        except BaseException as error:  # noqa: BLE001 - nothing may pass a callback
            self.error = error
            return FAILED
        return int(self._set_up != before)

    def _command(self, _codec: int, number: int, mode: int, stop: int, force: int, into: int) -> int:
        command = Command(DriveMode(mode), array_at(force, LEGS, np.float64), bool(stop))
        try:
            self.dialogue, frames = self.protocol.command(self.dialogue, command, number)
        except BaseException as error:  # noqa: BLE001 - as above
            self.error = error
            return FAILED
        array_at(into, len(frames), FRAME)[:] = sent_array(frames)
        return len(frames)


def controller_end(protocol: DriveProtocol, setup: DriveSetup) -> ControllerEnd:
    """Return the controller's end of a family, compiled where the family is."""
    make = getattr(protocol, "controller_end", None)
    end: ControllerEnd = ControllerEnd(protocol, setup) if make is None else make(setup)
    return end
