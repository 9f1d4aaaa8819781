"""Frame, and DriveProtocol: the pure codec of one drive family, both ends of one table.

A new drive family is one file that implements `DriveProtocol` and one row in `drivers.PROTOCOLS`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from drivers.arrays import Array, Ints
from drivers.signals import Command, Measurement, Reaction

EXTENDED = 1
FD = 2
BRS = 4
ESI = 8
REMOTE = 16
ERROR = 32

ALWAYS = -(1 << 62)
"""Before any time, ns."""


class Frame(NamedTuple):
    """One CAN frame."""

    id: int
    data: bytes
    flags: int = 0
    """Sum of EXTENDED, FD, BRS, ESI, REMOTE, ERROR."""


class Received(NamedTuple):
    """A frame and the instant at which its last bit was on the wire."""

    t_ns: int
    """ns on the run's monotonic clock."""
    frame: Frame


HEAD = struct.Struct("<qIHH")
"""What stands before the data of each frame in a run: time, identifier, flags, number of data bytes."""
_head = HEAD.pack


def run_of(frames: Sequence[Received]) -> bytes:
    """Return the frames as one run of bytes in their order, each HEAD and data: what compiled codecs read."""
    return b"".join(
        [_head(t_ns, identifier, flags, len(data)) + data for t_ns, (identifier, data, flags) in frames]
    )


class Sync(NamedTuple):
    """All drives latch their encoders; `counter` is the tick modulo 256."""

    counter: int


class DeviceCommand(NamedTuple):
    """A command as the drives decode it. `legs` lists the legs that this frame addresses."""

    legs: tuple[int, ...]
    mode: int
    force: Array
    """N, one per addressed leg."""
    counter: int


class Configure(NamedTuple):
    """Set-up of one drive (leg 0..5)."""

    leg: int
    watchdog_s: float
    reaction: Reaction


class EmergencyStop(NamedTuple):
    """All drives fault at once."""


class Rejected(NamedTuple):
    """A frame of ours that cannot be trusted."""

    reason: str


DeviceMessage = Sync | DeviceCommand | Configure | EmergencyStop | Rejected


class Feedback(NamedTuple):
    """What one drive sends after a SYNC."""

    leg: int
    length: float
    rate: float
    force: float
    state: int
    """DriveState; plus INVALID where length and rate are of no use."""
    counter: int
    """Low four bits of the SYNC counter at which the length was latched."""


class Status(NamedTuple):
    """A drive's heartbeat."""

    leg: int
    state: int
    fault: int


class DriveProtocol(Protocol):
    """Pure codec. Implementations hold compiled tables only."""

    @property
    def feedback_ids(self) -> frozenset[int]:
        """Identifiers of the cyclic feedback, one per leg: the daemon's drain waits for these."""

    # controller side
    def sync(self, tick: int) -> tuple[Frame, ...]:
        """Frames that make all drives latch their encoders."""

    def configure(self, watchdog_s: float, reaction: Reaction) -> tuple[Frame, ...]:
        """Frames that set up the six drives."""

    def command(self, command: Command, tick: int) -> tuple[Frame, ...]:
        """Frames of one tick's command. Raises ProtocolError if a force does not fit."""

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Frames that fault all drives at once."""

    def decode(
        self, frames: Sequence[Received], tick: int, previous: Measurement, since_ns: int = ALWAYS
    ) -> Measurement:
        """Fold this tick's frames into the previous Measurement. Foreign frames are ignored.

        What arrived before `since_ns`, the tick's scheduled time, is no answer to its SYNC.
        """

    def decode_run(self, run: bytes, tick: int, previous: Measurement, since_ns: int = ALWAYS) -> Measurement:
        """As `decode`, of frames joined by `run_of`."""

    def fresh(self, frame: Frame, tick: int) -> bool:
        """Tell whether a frame is a feedback to this tick's SYNC, by identifier and counter alone."""

    # device side
    def parse(self, frame: Frame) -> DeviceMessage | None:
        """Decode at the drives' end; None when the frame is not for them."""

    def feedbacks(
        self,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        counter: int,
    ) -> list[Frame]:
        """Encode the six drives' answers to one SYNC, leg order.

        length m, rate m/s, force N, state as in `Feedback`, each (6,); counter: the low four bits count.
        """

    def feedback(self, feedback: Feedback) -> Frame:
        """Encode one drive's cyclic feedback."""

    def status(self, status: Status) -> Frame:
        """Encode one drive's heartbeat."""

    # bus time
    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame sent once per tick, SYNC included (lengths and flags count)."""
