"""What goes into one tick and what comes out; what flows between is the record of `drivers.tick_columns`."""

from enum import IntEnum
from typing import NamedTuple

from drivers.arrays import Rows
from drivers.frame_array import NO_FRAMES
from drivers.signals import LEGS, BusState, Refusal


class Operator(IntEnum):
    """Operator commands, an input of the cycle like any other."""

    ENGAGE = 1
    STOP = 2
    RESET = 3
    ESTOP = 4
    SETPOINT = 5
    """Go to a pose: in a log only; TickInput has the poses as `setpoints`."""
    RELEASE = 6
    """Let go of a platform whose brakes are not proven shut."""
    START = 7
    """Go on along the path."""
    HOLD = 8
    """Slow down along the path to rest, and stay."""
    SPEED = 9
    """Set the speed along the path: 0 .. 1 of the configured one."""
    PARK = 10
    """Go back to the reference's first pose at set-up speed, and park."""
    KEY = 11
    """The operator's key is held."""
    END = 12
    """End a run that stays; it decides nothing in the cycle."""
    JOG = 13
    """Move along one axis or leg from hold: index in JOG_NAMES, and -1 .. 1 of the set-up speed."""


NUMBERS = {
    Operator.SETPOINT: 6,
    Operator.START: 0,
    Operator.HOLD: 0,
    Operator.SPEED: 1,
    Operator.PARK: 0,
    Operator.KEY: 0,
    Operator.JOG: 2,
}
"""Commands for the motion, and how many numbers each has."""
ORDERS = frozenset(NUMBERS) - {Operator.SETPOINT}
"""Those that TickInput has as `orders`."""


JOG_NAMES = ("x", "y", "z", "rx", "ry", "rz", "leg0", "leg1", "leg2", "leg3", "leg4", "leg5")
"""What can be jogged: axes of the base frame, turns about them through the platform's origin, legs."""


class Order(NamedTuple):
    """A command for the motion, with its numbers."""

    command: Operator
    """One of ORDERS."""
    numbers: tuple[float, ...] = ()
    """See `Operator`."""


class SetPoint(NamedTuple):
    """A pose to go to: m, and the rotation vector in rad, in the base frame."""

    x: float
    y: float
    z: float
    rx: float
    ry: float
    rz: float


REASONS = {
    Refusal.NOT_TRACKING: "the platform does not follow set-points now",
    Refusal.NOT_A_POSE: "it is no pose: six finite numbers, at most 180 deg of turn",
    Refusal.STROKE: "a leg would be outside the soft ends of its stroke",
    Refusal.CONDITION: "it is too near to a singularity (limits.condition)",
    Refusal.FORCE: "a leg could need more than limits.force_N",
    Refusal.SPEED: "a leg would be faster than limits.speed_m_s, or too fast to stop before a soft end",
}
ON_THE_WAY = "stopped on the way: beyond, "


def explain(refusal: int) -> str:
    """Say why a set-point was refused; empty for one that was taken."""
    reasons = [text for bit, text in REASONS.items() if refusal & bit]
    return (ON_THE_WAY if refusal & Refusal.ON_THE_WAY else "") + "; ".join(reasons)


class TickInput(NamedTuple):
    """All that changes a decision of one tick; recorded whole, so that replay is exact.

    The defaults are those of a tick on time, without frames, errors or commands.
    """

    tick: int
    t_ns: int
    """Scheduled time of the tick on the monotonic clock."""
    lateness_ns: int = 0
    """How late the loop woke up."""
    skipped: int = 0
    """Whole periods skipped just before this tick."""
    stretched_ns: int = 0
    """How long the time of a virtual bench stood still since the last tick."""
    sync_skew_ns: int = 0
    """From SYNC on the first of several buses to SYNC on the last, of this tick."""
    frames: Rows = NO_FRAMES
    """Received since the last step, in the order consumed: elements of FRAME."""
    sends_failed: int = 0
    """Frames that the bus did not take: the previous tick's command and this tick's SYNC."""
    bus_errors: int = 0
    """Error frames since the last tick."""
    bus_off: int = 0
    """Bit i: bus i is off."""
    bus_overflow: int = 0
    """Receive overflows since the last tick."""
    bus_state: BusState = BusState.UNKNOWN
    """The worst of the CAN controller since the last tick: recorded, decides nothing."""
    recorder_alive: bool = True
    recorder_dropped: int = 0
    """Ticks that the recorder has lost so far."""
    operator: tuple[Operator, ...] = ()
    compute_ns: int = 0
    """Time that the previous step took: recorded, decides nothing."""
    latch_ns: tuple[int, ...] = (0,) * LEGS
    """From the wake-up to the end of the SYNC or poll on which the drive of each leg latched its encoder; 0:
    none went out."""
    setpoints: tuple[SetPoint, ...] = ()
    """For a live reference, in the order received."""
    orders: tuple[Order, ...] = ()
    """For the motion, in the order received."""


class TickOutput(NamedTuple):
    """The frames to send and the record row."""

    frames: Rows
    """Elements of FRAME."""
    row: Rows
    """One element of ROW."""
