"""Frames, and what a drive family is as data.

`docs/guides/own-drives.md` shows how a new family is written.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS, Reaction

EXTENDED = 1
FD = 2
BRS = 4
ESI = 8
REMOTE = 16
ERROR = 32
STRANGE = EXTENDED | FD | REMOTE | ERROR
"""Flags that no classic data frame with an identifier of 11 bits has."""
BUS = 256
"""One step of the bus index."""

ALWAYS = -(1 << 62)
"""Before any time, ns."""
ALL_LEGS = tuple(range(LEGS))


class Frame(NamedTuple):
    """One CAN frame."""

    id: int
    """Identifier, without flags."""
    data: bytes
    """What it carries."""
    flags: int = 0
    """Sum of EXTENDED, FD, BRS, ESI, REMOTE, ERROR, and BUS times the index of its bus."""

    @property
    def bus(self) -> int:
        """Index of the bus that carries it, 0..127."""
        return self.flags // BUS


def off_bus(frame: Frame) -> Frame:
    """Return a frame as it would be on bus 0."""
    return frame._replace(flags=frame.flags % BUS) if frame.flags >= BUS else frame


class Received(NamedTuple):
    """A frame and the instant at which its last bit was on the wire."""

    t_ns: int
    """ns on the run's monotonic clock."""
    frame: Frame
    """What was received."""


class DriveSetup(NamedTuple):
    """What the start-up dialogue sets in every drive, and the rate at which it is led."""

    watchdog_s: float
    reaction: Reaction
    rate_Hz: float


SERIAL, REVISION = "serial number", "revision"
"""What a drive may say of itself, by which one is told from another of the same node number."""


class Said(NamedTuple):
    """One figure that a drive has said of itself."""

    leg: int
    what: str
    """SERIAL or REVISION."""
    value: int

    @property
    def tells(self) -> bool:
        """Whether it tells one drive from another: a serial number of 0 or all ones was never written."""
        return self.what != SERIAL or self.value not in _UNWRITTEN


_UNWRITTEN = frozenset({0, *((1 << bits) - 1 for bits in (32, 48, 64, 96))})
"""The widths of serial numbers."""


SINGLE = 2.0**-24
"""Share by which a number is off as a single, rounded to nearest."""
FARTHEST_m = 2.0
"""No leg is farther from where its drive reads zero; what singles leave of its rate and force is less than
anything else."""


class Resolution(NamedTuple):
    """Largest deviations by the steps of the frames; every array is (6,), leg order.

    A field that is rounded is off by half a step; one that may be truncated, at either end, by a whole one.
    """

    length: Array
    """m, of a length that is read."""
    rate: Array
    """m/s, of a rate that is read; see `at`."""
    force: Array
    """N at the leg, without losses, of a force that is commanded."""
    differences: bool = False
    """Whether a rate is no reading, but the slope at the end of the parabola through three lengths."""

    @classmethod
    def of(
        cls, length: Array | float, rate: Array | float, force: Array | float, *, differences: bool = False
    ) -> Self:
        """Return the deviations; their signs do not count, a value for all legs is repeated."""
        q, dq, f = (np.abs(np.broadcast_to(np.array(x, float), LEGS)) for x in (length, rate, force))
        return cls(q, dq, f, differences)

    def at(self, rate_Hz: float) -> Self:
        """Return the deviations at a rate of the loop, which a rate from `differences` depends on.

        Counts are rounded or truncated, so their differences are off by half a count each. Of the last three
        lengths `difference` takes 1.5, 2 and 0.5 times: two counts a period.
        """
        return self._replace(rate=2.0 * rate_Hz * self.length) if self.differences else self


@dataclass(frozen=True, eq=False)
class Traits:
    """What a family of drives is, as data: no frame changes it."""

    family: str
    """Emulated drives: an entry point of the group `hil.emulated_drives`."""
    resolution: Resolution
    """How far readings and commands are off by the steps of the frames."""
    sent: tuple[Frame, ...]
    """One example of every frame that the controller sends once per tick; lengths and flags count."""
    feedbacks: tuple[Frame, ...]
    """One example of every feedback of a tick."""
    emergency_stop: tuple[Frame, ...]
    """Frames that fault all drives at once."""
    feedback_ids: frozenset[int]
    """What `awaited` returns for all frames that make the six feedbacks of a tick.

    The drain waits for these. They are identifiers, but where `shares_identifiers`.
    """
    shares_identifiers: bool = False
    """Whether feedbacks share an identifier, or change it; then no interface can wait for them."""
    identity_requests: tuple[tuple[Frame, ...], ...] = ()
    """Requests for serial number and revision, one frame a drive, in rounds; each round is answered before
    the next is sent. Empty where no drive can be asked."""
    database: tuple[str, str] | None = None
    """Name and text of the DBC file that goes into the log, if the family has one."""
    command_delay_ticks: int = 0
    """Ticks from a command to the frames that carry it; 1 where these are the polls of the next tick."""
    set_up_frames: int = 0
    """The largest number of frames of the set-up in one tick."""
    reset_ticks: int = 3
    """For how many ticks DriveMode.RESET is commanded to clear the drives' faults."""
    reactions: tuple[Reaction, ...] = (Reaction.BRAKE,)
    """What the drives can do by themselves after silence; `controller_end` refuses another."""
    dangers: tuple[str, ...] = ()
    """What the drives do not do for safety, one sentence each, for `hil check`."""
    stop_latches: bool = False
    """Whether the drives go to FAULT by `emergency_stop`; else they switch off and report no reason."""
    force_on_brakes: bool = False
    """Whether a drive in READY gives force on its closed brake; else force and open brake go together."""
    answers_name_sync: bool = False
    """Whether a feedback says which SYNC or poll it answers; else the tick in which it comes tells."""
    latches_together: bool = False
    """Whether one SYNC latches all encoders of a bus; else each drive has a poll or clock of its own."""
    unasked_s: float = 0.0
    """Period of the readings that each drive sends by a timer as well as to a poll; 0 where it does not."""
    has_watchdog: bool = True
    """Whether `drives.watchdog_ms` is that of the drives, set from here or with their maker's tool."""
    power_told: Literal["feedback", "heartbeat", "never"] = "feedback"
    """What tells that a drive is no longer enabled."""
    reported_lengths: tuple[Array, Array] | None = None
    """The shortest and the longest leg lengths, (6,) m, that feedback carries; None where it carries any."""

    @property
    def cyclic_frames(self) -> tuple[Frame, ...]:
        """One example of every frame sent once per tick."""
        return (*self.sent, *self.feedbacks)
