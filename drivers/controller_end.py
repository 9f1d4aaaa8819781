"""The controller's end of six drives: the dialogue with them, their frames decoded, commands encoded.

A family that is compiled gives a `CompiledController`. A `ControllerEnd` in plain Python goes by the same
addresses, through callbacks.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import FAILED, Pointed, context_of, data_at, integers_at, of_python, pointed
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME, sent_array
from drivers.protocol import ALWAYS, DriveProtocol, DriveSetup
from drivers.signals import LEGS, Command, DriveMode
from drivers.tick_columns import TICK, Record

MOST_FRAMES = 64
"""Room for the frames of a command, and for those that start a tick."""
_FRAME_WORDS = FRAME.itemsize // 8


def array_at(address: int, count: int, dtype: Any) -> Any:
    """Return `count` elements of a type at an address, from Python."""
    size = count * np.dtype(dtype).itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(address), dtype)


def tick_at(address: int) -> Record:
    """Return the record of a tick at an address, from Python."""
    return np.ndarray((), TICK, array_at(address, TICK.itemsize // 8, np.float64))


OPENINGS = np.dtype([("at", "<i8"), ("kinds", "<i8"), ("frames", "<i8")])
"""Address and shape of elements of FRAME: what starts a tick, one kind after the other."""


@pointed(record(OPENINGS), INTEGER, INTEGER)
def put_opening(openings: Any, number: int, into: int) -> int:
    """Put the frames that start a tick at an address; return how many."""
    words = openings.frames * _FRAME_WORDS
    first = openings.at + number % openings.kinds * words * 8
    integers_at(into, words)[:] = integers_at(first, words)
    return int(openings.frames)


class ControllerEnd(ABC):
    """The dialogue with six drives. Mutable state: that, which `start` begins.

    A tick: `begin` is sent, the drives answer, `take` folds their frames in, then `give` is sent and, while
    the drives are not powered, `set_up`. Where the poll is the command, `give` only remembers it, the next
    `begin` sends it, and `DriveProtocol.command_delay_ticks` is 1.

    For compiled passes ``decode(codec, frames, count, since_ns, last, tick)`` and ``command(codec, number,
    mode, stop, force, into)`` are `take` and `give` by address: of elements of FRAME, of records of TICK, of
    six forces in N. `decode` returns a status, > 0 where other drives are set up than before; `command` the
    number of frames, FAILED where a force does not fit. ``opening(opener, number, into)`` is `begin`.
    """

    codec = 0
    """Address of what the two functions work on."""
    decode: int
    command: int
    opening: int
    opener = 0
    """Address of what `opening` works on."""
    error: BaseException | None = None
    """What a function in Python met, which returned FAILED."""

    def __init__(self) -> None:
        self.decode, kept = of_python(self._decode, *[INTEGER] * 6)
        self.command, also = of_python(self._command, *[INTEGER] * 6)
        self.opening, begins = of_python(self._opening, *[INTEGER] * 3)
        self._keeps = kept, also, begins
        self.start()
        self._set_up = self.legs_set_up()

    @abstractmethod
    def start(self) -> None:
        """Begin the dialogue: no drive has been set up."""

    @abstractmethod
    def begin(self, number: int) -> Rows:
        """Return the frames that start a tick, SYNC or polls, as elements of FRAME."""

    @abstractmethod
    def take(self, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS) -> None:
        """Fill the measurement of a tick from that of the last one and the frames since, elements of FRAME.

        since_ns: when the loop woke up; the SYNC or poll of each leg was out `latch_ns` of the tick later.
        Fills every column of the part. Frames that are nobody's are ignored; those of another controller and
        a second answer of one node are named in `foreign` and `doubled`, a set-up that is not ours in
        `altered`, as far as the protocol can tell. A fault code that is not a DriveFault is the drive's own.
        """

    @abstractmethod
    def give(self, command: Command, number: int) -> Rows:
        """Return the frames of a tick's command. Raises ProtocolError if a force does not fit."""

    @abstractmethod
    def set_up(self, tick: Record) -> Rows:
        """Return the start-up dialogue's frames of a tick. No drive in READY or RUN is disturbed."""

    @abstractmethod
    def lacks(self) -> tuple[str, ...]:
        """Return for each drive, in words, the part of its set-up that it has not confirmed; empty: none."""

    @abstractmethod
    def remembered(self) -> Any:
        """Return a copy of the dialogue, for `remember` of another end of the same drives."""

    @abstractmethod
    def remember(self, dialogue: Any) -> None:
        """Go on from a dialogue that was `remembered`."""

    def legs_set_up(self) -> tuple[bool, ...]:
        """Return which of the six drives have been set up since `start`, on their own word."""
        return tuple(not each for each in self.lacks())

    def carried(self, force: Array) -> Array:
        """Return what a command of forces (6,) N gives legs at rest: a field may have steps."""
        return force

    def presume_running(self) -> None:  # noqa: B027 - some commands are the same to all
        """Take all drives for enabled, whether they have been heard or not."""

    def refuse(self, force: Array) -> None:
        """Raise what a command met that does not fit, or a frame."""
        error, self.error = self.error, None
        raise error or self.unfit(force)

    def unfit(self, force: Array) -> ProtocolError:
        """Error for a force that the drives cannot represent."""
        return ProtocolError(f"force command {force.tolist()} N")

    def _decode(self, _codec: int, at: int, count: int, since_ns: int, last: int, tick: int) -> int:
        frames = array_at(at, count, FRAME) if count else sent_array(())
        try:
            self.take(frames, tick_at(last), tick_at(tick), since_ns)
            before, self._set_up = self._set_up, self.legs_set_up()
        except BaseException as error:  # noqa: BLE001 - nothing may pass a callback
            self.error = error
            return FAILED
        return int(self._set_up != before)

    def _command(self, _codec: int, number: int, mode: int, stop: int, force: int, into: int) -> int:
        command = Command(DriveMode(mode), array_at(force, LEGS, np.float64), bool(stop))
        return self._put(into, lambda: self.give(command, number))

    def _opening(self, _opener: int, number: int, into: int) -> int:
        return self._put(into, lambda: self.begin(number))

    def _put(self, into: int, given: Callable[[], Rows]) -> int:
        try:
            frames = given()
            array_at(into, MOST_FRAMES, FRAME)[: len(frames)] = frames
        except BaseException as error:  # noqa: BLE001 - as above
            self.error = error
            return FAILED
        return len(frames)


class CompiledController(ControllerEnd):
    """A `ControllerEnd` that is compiled. Mutable state: its record, which has the dialogue.

    A family gives `set_up`, `lack` and `unfit`.
    """

    first: str
    """The first field of the record that is the dialogue's, as are all behind it."""

    def __init__(self, begun: Rows, decode: Pointed, command: Pointed, openings: Rows | Pointed) -> None:
        """Take the record before any drive was heard, () of its dtype, and the functions that work on it.

        openings: elements of FRAME that start a tick (kinds, frames), one kind after the other; or the
        function that puts them.
        """
        self._begun, self.state, self._decoding, self._commanding = begun, begun.copy(), decode, command
        self.decode, self.command = decode.address, command.address
        self.codec = data_at(self.state)
        self._opens, self._openings, self.opener = put_opening, openings, self.codec
        if isinstance(openings, Pointed):
            self._opens = openings
        else:
            self._table = context_of(OPENINGS, at=openings)
            self._table["kinds"], self._table["frames"] = openings.shape
            self.opener = data_at(self._table)
        self.opening = self._opens.address

    def start(self) -> None:
        """Begin the dialogue: no drive has been set up."""
        self.state[...] = self._begun

    @abstractmethod
    def lack(self, leg: int) -> str:
        """Return in words the part of its set-up that a drive has not confirmed; empty: none."""

    def lacks(self) -> tuple[str, ...]:
        """Return for each drive, in words, the part of its set-up that it has not confirmed; empty: none."""
        return tuple(map(self.lack, range(LEGS)))

    def begin(self, number: int) -> Rows:
        """Return the frames that start a tick."""
        into = np.empty(MOST_FRAMES, FRAME)
        return into[: self._opens(self.opener, number, data_at(into))]

    def take(self, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS) -> None:
        """Fill the measurement of a tick from that of the last one and the frames since."""
        self._decoding(self.state, data_at(frames), len(frames), since_ns, last, tick)

    def give(self, command: Command, number: int) -> Rows:
        """Return the frames of a tick's command. Raises ProtocolError if a force does not fit."""
        into, force = np.empty(MOST_FRAMES, FRAME), np.ascontiguousarray(command.force, float)
        given = number, int(command.mode), int(command.stop), data_at(force), data_at(into)
        sent = FAILED if force.shape != (LEGS,) else self._commanding(self.state, *given)
        if sent == FAILED:
            raise self.unfit(force)
        return into[:sent]

    def remembered(self) -> Rows:
        """Return a copy of the dialogue, for `remember` of another end of the same drives."""
        return self.state.copy()

    def remember(self, dialogue: Rows) -> None:
        """Go on from a dialogue that was `remembered`."""
        names = self.state.dtype.names or ()
        for name in names[names.index(self.first) :]:
            self.state[name] = dialogue[name]


def controller_end(protocol: DriveProtocol, setup: DriveSetup) -> ControllerEnd:
    """Return the controller's end of a family. Raises ProtocolError if the set-up does not fit."""
    return cast("ControllerEnd", protocol.controller_end(setup))
