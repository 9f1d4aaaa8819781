"""The controller's end of six drives: the dialogue with them, their frames decoded, commands encoded."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import FAILED, Pointed, context_of, data_at, integers_at, pointed
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME
from drivers.protocol import ALWAYS
from drivers.signals import LEGS, Command
from drivers.tick_columns import Record

MOST_FRAMES = 64
"""Room for the frames of a command, and for those that start a tick."""
_FRAME_WORDS = FRAME.itemsize // 8
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
    """The dialogue with six drives, compiled. Mutable state: its record, which has the dialogue.

    A tick: `begin` is sent, the drives answer, `take` folds their frames in, then `give` is sent and, while
    the drives are not powered, `set_up`. Where the poll is the command, `give` only remembers it, the next
    `begin` sends it, and `Traits.command_delay_ticks` is 1.

    Compiled passes call the family's functions by address: ``decode(codec, frames, count, since_ns, last,
    tick)`` is `take`, ``command(codec, number, mode, stop, force, into)`` is `give` and ``opening(opener,
    number, into)`` is `begin`; with addresses of elements of FRAME, of records of TICK, of six forces in N.
    `decode` returns a status, > 0 where other drives are set up than before; the others return the number of
    frames, `command` FAILED where a force does not fit.
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
        self.codec = self.opener = data_at(self.state)
        self._opens, self._openings = put_opening, openings
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

    def begin(self, number: int) -> Rows:
        """Return the frames that start a tick, SYNC or polls, as elements of FRAME."""
        into = np.empty(MOST_FRAMES, FRAME)
        return into[: self._opens(self.opener, number, data_at(into))]

    def take(self, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS) -> None:
        """Fill the measurement of a tick from that of the last one and the frames since, elements of FRAME.

        since_ns: when the loop woke up; the SYNC or poll of each leg was out `latch_ns` of the tick later.
        Fills every column of the part. Frames of no drive here are ignored; those of another controller and
        a second answer of one node are named in `foreign` and `doubled`, a set-up that is not ours in
        `altered`, as far as the protocol can tell. A fault code that is not a DriveFault is the drive's own.
        """
        self._decoding(self.state, data_at(frames), len(frames), since_ns, last, tick)

    def give(self, command: Command, number: int) -> Rows:
        """Return the frames of a tick's command. Raises ProtocolError if a force does not fit."""
        into, force = np.empty(MOST_FRAMES, FRAME), np.ascontiguousarray(command.force, float)
        given = number, int(command.mode), int(command.stop), data_at(force), data_at(into)
        sent = FAILED if force.shape != (LEGS,) else self._commanding(self.state, *given)
        if sent == FAILED:
            raise self.unfit(force)
        return into[:sent]

    @abstractmethod
    def set_up(self, tick: Record) -> Rows:
        """Return the start-up dialogue's frames of a tick. No drive in READY or RUN is disturbed."""

    @abstractmethod
    def lack(self, leg: int) -> str:
        """Return in words the part of its set-up that a drive has not confirmed; empty: none."""

    @abstractmethod
    def unfit(self, force: Array) -> ProtocolError:
        """Error for a force that the drives cannot represent."""

    def lacks(self) -> tuple[str, ...]:
        """Return `lack` of each drive."""
        return tuple(map(self.lack, range(LEGS)))

    def legs_set_up(self) -> tuple[bool, ...]:
        """Return which of the six drives have been set up since `start`, on their own word."""
        return tuple(not each for each in self.lacks())

    def carried(self, force: Array) -> Array:
        """Return the forces (6,) N that legs at rest get for a command: a field may have steps."""
        return force

    def presume_running(self) -> None:  # noqa: B027 - some commands are the same to all
        """Take all drives for enabled, whether they have been heard or not."""

    def remembered(self) -> Rows:
        """Return a copy of the dialogue, for `remember` of another end of the same drives."""
        return self.state.copy()

    def remember(self, dialogue: Rows) -> None:
        """Go on from a dialogue that was `remembered`."""
        names = self.state.dtype.names or ()
        for name in names[names.index(self.first) :]:
            self.state[name] = dialogue[name]
