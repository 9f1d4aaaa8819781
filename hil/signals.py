"""Input and output of one control tick; values between them are in the record of `drivers.tick_columns`."""

from enum import IntEnum
from typing import NamedTuple

from drivers.arrays import Rows
from drivers.frame_array import NO_FRAMES
from drivers.signals import LEGS, BusState, Refusal


class Operator(IntEnum):
    """Commands of the operator to the control cycle, recorded in the log like every other input."""

    ENGAGE = 1
    STOP = 2
    RESET = 3
    ESTOP = 4
    SETPOINT = 5
    """Go to a pose. In logs only; TickInput has the poses as `setpoints`."""
    RELEASE = 6
    """Remove the leg forces although the brakes have not passed their test."""
    START = 7
    """Move on along the configured path."""
    HOLD = 8
    """Slow down along the path to rest, and hold that pose."""
    SPEED = 9
    """Set the speed along the path: 0 .. 1 of the configured speed."""
    PARK = 10
    """Go back to the reference's first pose at set-up speed, and park."""
    KEY = 11
    """The operator holds down the key that enables motion."""
    END = 12
    """End a run that `operator.stays` keeps open; the control cycle ignores it."""
    JOG = 13
    """Move along one axis or leg from hold: index in JOG_NAMES, and speed -1 .. 1 of the set-up speed."""


NUMBERS = {
    Operator.SETPOINT: 6,
    Operator.START: 0,
    Operator.HOLD: 0,
    Operator.SPEED: 1,
    Operator.PARK: 0,
    Operator.KEY: 0,
    Operator.JOG: 2,
}
"""Motion command -> count of its numbers."""
ORDERS = frozenset(NUMBERS) - {Operator.SETPOINT}
"""Motion commands that TickInput has as `orders`."""


JOG_NAMES = ("x", "y", "z", "rx", "ry", "rz", "leg0", "leg1", "leg2", "leg3", "leg4", "leg5")
"""Directions of a jog: axes of the base frame, rotations about them through the platform's origin, legs."""


class Order(NamedTuple):
    """A motion command of the operator with its numbers (a speed, a jog axis)."""

    command: Operator
    """One of ORDERS."""
    numbers: tuple[float, ...] = ()
    """Their meaning: see `Operator`."""


class SetPoint(NamedTuple):
    """Target pose in the base frame: position in m, rotation vector in rad."""

    x: float
    y: float
    z: float
    rx: float
    ry: float
    rz: float


REASONS = {
    Refusal.NOT_TRACKING: "the platform does not follow set-points now",
    Refusal.NOT_A_POSE: "it is not a pose: six finite numbers, at most 180 deg of rotation",
    Refusal.STROKE: "a leg would be outside the soft ends of its stroke",
    Refusal.CONDITION: "it is too close to a singularity (limits.condition)",
    Refusal.FORCE: "a leg could need more than limits.force_N",
    Refusal.SPEED: "a leg would be faster than limits.speed_m_s, or too fast to stop before a soft end",
}
ON_THE_WAY = "stopped on the way: farther on, "


def explain(refusal: int) -> str:
    """Text of all reasons in the bits of `refusal` why a set-point was refused; empty if it was accepted."""
    reasons = [text for bit, text in REASONS.items() if refusal & bit]
    return (ON_THE_WAY if refusal & Refusal.ON_THE_WAY else "") + "; ".join(reasons)


class TickInput(NamedTuple):
    """All inputs that change a decision of one tick, recorded completely so that replay is exact.

    The defaults describe a tick on time, without frames, errors or commands.
    """

    tick: int
    t_ns: int
    """Scheduled time of the tick on the monotonic clock."""
    lateness_ns: int = 0
    """Delay of the loop's wake-up."""
    skipped: int = 0
    """Whole periods skipped just before this tick."""
    stretched_ns: int = 0
    """Time during which the clock of a virtual bench stood still since the last tick."""
    sync_skew_ns: int = 0
    """Time from SYNC on the first of several buses to SYNC on the last, at this tick."""
    frames: Rows = NO_FRAMES
    """Frames received since the last step, in the order consumed: elements of FRAME."""
    sends_failed: int = 0
    """Frames that the bus did not accept: the previous tick's command and this tick's SYNC."""
    bus_errors: int = 0
    """Error frames since the last tick."""
    bus_off: int = 0
    """Bit i is 1 while CAN bus i is in the state bus-off."""
    bus_overflow: int = 0
    """Receive overflows since the last tick."""
    bus_state: BusState = BusState.UNKNOWN
    """Worst state of the CAN controller since the last tick; recorded, without effect on decisions."""
    recorder_alive: bool = True
    recorder_dropped: int = 0
    """Ticks that the recorder has lost so far."""
    operator: tuple[Operator, ...] = ()
    compute_ns: int = 0
    """Duration of the previous step; recorded, without effect on decisions."""
    latch_ns: tuple[int, ...] = (0,) * LEGS
    """Time from the wake-up to the end of the SYNC or poll at which each leg's drive sampled its encoder; 0:
    none was sent."""
    setpoints: tuple[SetPoint, ...] = ()
    """Set-points for a live reference, in the order received."""
    orders: tuple[Order, ...] = ()
    """Motion commands, in the order received."""


class TickOutput(NamedTuple):
    """Result of one control tick: the frames to send and the row to record."""

    frames: Rows
    """(n,) of FRAME."""
    row: Rows
    """One element of ROW, the values of the tick for the log."""
