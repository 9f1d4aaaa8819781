"""The controller's end of six drives: start-up dialogue, decoding of their frames, encoding of commands."""

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
"""Most frames of a command, and most frames that start a tick."""
_FRAME_WORDS = FRAME.itemsize // 8
OPENINGS = np.dtype([("at", "<i8"), ("kinds", "<i8"), ("frames", "<i8")])
"""Address and shape of the frames that start a tick, FRAME records; the ticks take the kinds in turn."""


@pointed(record(OPENINGS), INTEGER, INTEGER)
def put_opening(openings: Any, number: int, into: int) -> int:
    """Write a tick's first frames (SYNC or polls) to FRAME records at `into`; returns their number."""
    words = openings.frames * _FRAME_WORDS
    first = openings.at + number % openings.kinds * words * 8
    integers_at(into, words)[:] = integers_at(first, words)
    return int(openings.frames)


class ControllerEnd(ABC):
    """The controller's end of six drives: start-up dialogue, decoder and encoder. Mutable state: its record.

    In a tick the frames of `begin` are sent, the drives answer, and `take` decodes their frames. Then the
    frames of `give` are sent and, while the drives are not powered, those of `set_up`. If the poll is the
    command, `give` only stores it, the next `begin` sends it, and `Traits.command_delay_ticks` is 1.

    Compiled code calls the family's functions by address: ``decode(codec, frames, count, since_ns, last,
    tick)`` is `take`, ``command(codec, number, mode, stop, force, into)`` is `give` and ``opening(opener,
    number, into)`` is `begin`. Arguments are addresses of FRAME records, of records of TICK, and of six
    forces, N. `decode` returns a status, > 0 if the set of configured drives has changed. The others return
    the number of frames, `command` FAILED if a force does not fit.
    """

    first: str
    """First field of the record that belongs to the dialogue; all later fields do, too."""

    def __init__(self, begun: Rows, decode: Pointed, command: Pointed, openings: Rows | Pointed) -> None:
        """Start from the initial record, () of its dtype, and the compiled functions that work on it.

        openings: FRAME records that start a tick (kinds, frames), which take turns; or the function that
        writes them.
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
        """Restart the start-up dialogue: all drives count as not configured."""
        self.state[...] = self._begun

    def begin(self, number: int) -> Rows:
        """Frames that start tick `number`, SYNC or polls, as FRAME records."""
        into = np.empty(MOST_FRAMES, FRAME)
        return into[: self._opens(self.opener, number, data_at(into))]

    def take(self, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS) -> None:
        """Fill a tick's measurement from the last tick's and the frames (FRAME records) received since.

        since_ns: wake-up time of the loop; the SYNC or poll of each leg was sent `latch_ns` of the tick
        later. Fills every column of the part. Frames of unknown nodes are ignored. As far as the protocol can
        tell, `foreign` marks frames of another controller, `doubled` a second answer of one node, and
        `altered` a drive with another set-up than the one sent. A fault code that is not a DriveFault is the
        drive's own.
        """
        self._decoding(self.state, data_at(frames), len(frames), since_ns, last, tick)

    def give(self, command: Command, number: int) -> Rows:
        """Frames of the command of tick `number`. Raises ProtocolError if a force does not fit."""
        into, force = np.empty(MOST_FRAMES, FRAME), np.ascontiguousarray(command.force, float)
        given = number, int(command.mode), int(command.stop), data_at(force), data_at(into)
        sent = FAILED if force.shape != (LEGS,) else self._commanding(self.state, *given)
        if sent == FAILED:
            raise self.unfit(force)
        return into[:sent]

    @abstractmethod
    def set_up(self, tick: Record) -> Rows:
        """Frames of the start-up dialogue for this tick; none to drives that report READY or RUN."""

    @abstractmethod
    def lack(self, leg: int) -> str:
        """Text: the part of its set-up that a drive has not confirmed; empty if all is confirmed."""

    @abstractmethod
    def unfit(self, force: Array) -> ProtocolError:
        """Error for leg forces (6,) N that do not fit into the drives' command field."""

    def lacks(self) -> tuple[str, ...]:
        """Unconfirmed part of each drive's set-up, as text, in leg order; empty text if complete."""
        return tuple(map(self.lack, range(LEGS)))

    def legs_set_up(self) -> tuple[bool, ...]:
        """For each drive, True if it has confirmed its set-up since `start`."""
        return tuple(not each for each in self.lacks())

    def carried(self, force: Array) -> Array:
        """Forces (6,) N at legs at rest for a commanded force, after rounding to the field's steps."""
        return force

    def presume_running(self) -> None:  # noqa: B027 - families without such a state need none
        """Mark all drives as enabled, even if none has reported: for an emulated second controller."""

    def remembered(self) -> Rows:
        """Copy of the dialogue's state, for `remember` of a new controller's end of the same drives."""
        return self.state.copy()

    def remember(self, dialogue: Rows) -> None:
        """Restore the dialogue's state from a copy made by `remembered`: all fields from `first` on."""
        names = self.state.dtype.names or ()
        for name in names[names.index(self.first) :]:
            self.state[name] = dialogue[name]
