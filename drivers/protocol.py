"""CAN frames as Python objects, and the properties of a drive family as data.

`docs/guides/own-drives.md` shows how to write a new family.
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
"""Flags that a classic data frame with an identifier of 11 bits never has."""
BUS = 256
"""Step of the bus index in the flags."""

ALWAYS = -(1 << 62)
"""Time before any other, ns."""
ALL_LEGS = tuple(range(LEGS))


class Frame(NamedTuple):
    """One CAN frame: identifier, data and flags."""

    id: int
    """Identifier, without flags."""
    data: bytes
    """Data bytes."""
    flags: int = 0
    """Sum of EXTENDED, FD, BRS, ESI, REMOTE, ERROR, and BUS times the index of its bus."""

    @property
    def bus(self) -> int:
        """Index of the bus that carries the frame, 0..127."""
        return self.flags // BUS


def off_bus(frame: Frame) -> Frame:
    """The frame with bus index 0."""
    return frame._replace(flags=frame.flags % BUS) if frame.flags >= BUS else frame


class Received(NamedTuple):
    """A received frame and the time, ns, at which its last bit was on the wire."""

    t_ns: int
    """Time at which its last bit was on the wire, ns of the bus's clock."""
    frame: Frame
    """The received frame."""


class DriveSetup(NamedTuple):
    """Watchdog, reaction and rate that the start-up dialogue sets in every drive."""

    watchdog_s: float
    reaction: Reaction
    rate_Hz: float


SERIAL, REVISION = "serial number", "revision"
"""Data of a drive that tell it from another one with the same node number."""


class Said(NamedTuple):
    """A serial or revision number that a drive has reported."""

    leg: int
    what: str
    """SERIAL or REVISION."""
    value: int

    @property
    def tells(self) -> bool:
        """False for a serial number of 0 or all ones, which the maker never wrote: it identifies no drive."""
        return self.what != SERIAL or self.value not in _UNWRITTEN


_UNWRITTEN = frozenset({0, *((1 << bits) - 1 for bits in (32, 48, 64, 96))})
"""Serial numbers never written, in each width."""


SINGLE = 2.0**-24
"""Relative error of a single, rounded to nearest."""
FARTHEST_m = 2.0
"""Largest distance of a leg from the zero of its drive; the error of singles in rate and force is negligible.
"""


class Resolution(NamedTuple):
    """Largest errors from rounding to the steps of frame fields; every array is (6,), leg order.

    A rounded field is off by half a step; a field that either end may truncate, by a whole step.
    """

    length: Array
    """Error of a measured length, (6,) m."""
    rate: Array
    """Error of a measured rate, (6,) m/s; see `at`."""
    force: Array
    """Error of a commanded force, (6,) N at the leg, without losses."""
    differences: bool = False
    """True if a rate is not measured, but the slope at the end of the parabola through three lengths."""

    @classmethod
    def of(
        cls, length: Array | float, rate: Array | float, force: Array | float, *, differences: bool = False
    ) -> Self:
        """Resolution from values of either sign (m, m/s, N); a scalar counts for all six legs."""
        q, dq, f = (np.abs(np.broadcast_to(np.array(x, float), LEGS)) for x in (length, rate, force))
        return cls(q, dq, f, differences)

    def at(self, rate_Hz: float) -> Self:
        """Resolution at a loop rate; only the error of a rate computed by `differences` depends on it.

        Counts are rounded or truncated, so their differences are off by half a count each. `difference`
        weights the last three lengths with 1.5, 2 and 0.5: two counts per period.
        """
        return self._replace(rate=2.0 * rate_Hz * self.length) if self.differences else self


@dataclass(frozen=True, eq=False)
class Traits:
    """Properties of a drive family, constant during a run: frames, resolution, safety functions."""

    family: str
    """Name of the family's emulated drives: an entry point of the group `hil.emulated_drives`."""
    resolution: Resolution
    """Errors of readings and commands by the steps of the frames."""
    sent: tuple[Frame, ...]
    """One example of every frame that the controller sends once per tick; lengths and flags matter."""
    feedbacks: tuple[Frame, ...]
    """One example of every feedback of a tick."""
    emergency_stop: tuple[Frame, ...]
    """Frames of an emergency stop of all drives."""
    feedback_ids: frozenset[int]
    """Values of `awaited` for all frames of the six feedbacks of a tick.

    The drain waits for these. They are identifiers, unless `shares_identifiers`. Empty for drives that send
    by their timer alone (`unasked_s`): the newest reading since the last tick counts."""
    echoes: tuple[Frame, ...] = ()
    """One example of every answer to a command; it only takes bus time."""
    shares_identifiers: bool = False
    """True if feedbacks share an identifier, or change it; then no interface can wait for them."""
    identity_requests: tuple[tuple[Frame, ...], ...] = ()
    """Requests for serial number and revision, one frame per drive, in rounds; each round is answered before
    the next is sent. Empty if drives have no such request."""
    database: tuple[str, str] | None = None
    """Name and text of the DBC file that goes into the log, if the family has one."""
    command_delay_ticks: int = 0
    """Ticks from a command to the frames that carry it; 1 if these are the polls of the next tick."""
    set_up_frames: int = 0
    """Most frames of the start-up dialogue in one tick."""
    reset_ticks: int = 3
    """Ticks for which DriveMode.RESET is commanded to clear the drives' faults."""
    reactions: tuple[Reaction, ...] = (Reaction.BRAKE,)
    """Reactions to a silent controller that the drives can do; `controller_end` refuses others."""
    dangers: tuple[str, ...] = ()
    """Missing safety functions of the drives, one sentence each, for `hil check`."""
    stop_latches: bool = False
    """True if `emergency_stop` puts the drives into FAULT; else they switch off and report no reason."""
    force_on_brakes: bool = False
    """True if a drive in READY gives force on its closed brake; else force and open brake go together."""
    answers_name_sync: bool = False
    """True if a feedback identifies the SYNC or poll that it answers; else its tick of arrival decides."""
    latches_together: bool = False
    """True if one SYNC latches all encoders of a bus; else each drive has a poll or clock of its own."""
    unasked_s: float = 0.0
    """Period of the readings that each drive sends by a timer, with or without a poll, s; 0: none."""
    has_watchdog: bool = True
    """True if `drives.watchdog_ms` is that of the drives, set from here or with their maker's tool."""
    power_told: Literal["feedback", "heartbeat", "never"] = "feedback"
    """Message by which a drive reports that it is no longer enabled."""
    reports_force: bool = True
    """True if feedback carries the force, or torque or current, of a drive; else `drive_force` stays 0."""
    reported_lengths: tuple[Array, Array] | None = None
    """Shortest and longest leg lengths, (6,) m, that feedback can carry; None: no limit."""

    @property
    def timed(self) -> bool:
        """True if the drives send their readings by their timer alone."""
        return self.unasked_s > 0.0 and not self.feedback_ids

    def stray(self, unasked: float, asked: float, rate_Hz: float) -> float:
        """Share of a period of the loop by which a reading may have been sampled before its stated instant.

        unasked, asked: that share where a timer may have sent an answer, and where a poll is answered.
        """
        if self.timed:
            return asked + self.unasked_s * rate_Hz
        return unasked if self.unasked_s > 0.0 else asked

    @property
    def cyclic_frames(self) -> tuple[Frame, ...]:
        """One example of every frame that controller and drives send once per tick."""
        return (*self.sent, *self.feedbacks)
