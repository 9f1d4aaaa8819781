"""What the controller's end of single-motor drives remembers, and what one frame of a drive says."""

from typing import NamedTuple

from drivers.protocol import Frame
from drivers.signals import LEGS, NEVER, DriveMode, DriveState

OWN_CODE = 0x100
"""Added to a fault code of a family, so that none is taken for a DriveFault."""
RETRY_TICKS = 10
"""After which a request without an answer is repeated."""


class Heard(NamedTuple):
    """What one frame of a drive says."""

    leg: int
    broken: bool = False
    """It cannot be trusted."""
    foreign: bool = False
    """It is a command, so another controller's."""
    motion: tuple[float, float] | None = None
    """Turns of the motor and turns/s; None in a frame that is no feedback, or where it is of no use."""
    feedback: bool = False
    """It answers the poll."""
    torque: float | None = None
    """N m."""
    power: int | None = None
    """DriveState OFF (disabled), RUN (enabled) or FAULT; None where it does not say."""
    fault: int = 0
    """DriveFault, or OWN_CODE and the family's code."""
    answer: tuple[int, float] | None = None
    """Register and value, of the start-up dialogue."""


class Exchange(NamedTuple):
    """One request of the start-up dialogue, and what its answer must be."""

    name: str
    register: int
    frames: tuple[Frame, ...]
    """Sent together; the last one is answered."""
    value: float
    """What the drive must answer, in the drive's unit."""


class MotorDialogue(NamedTuple):
    """The controller's end; tuples have one element a leg."""

    exchanges: tuple[tuple[Exchange, ...], ...]
    watchdog_s: float
    mode: int = DriveMode.OFF
    torque: tuple[float, ...] = (0.0,) * LEGS
    """N m, of the last command."""
    rate: tuple[float, ...] = (0.0,) * LEGS
    """m/s, last read: it decides the losses."""
    power: tuple[int, ...] = (int(DriveState.BOOT),) * LEGS
    """DriveState OFF, RUN or FAULT, as last heard; BOOT: not yet."""
    ran: tuple[bool, ...] = (False,) * LEGS
    """Which were enabled since RUN is asked for."""
    done: tuple[int, ...] = (0,) * LEGS
    """1 for a drive that is heard, and 1 for each exchange that it has confirmed."""
    asked: tuple[int, ...] = (-RETRY_TICKS,) * LEGS
    """Tick of the last request."""
    read: tuple[float | None, ...] = (None,) * LEGS
    """What the last answer held that was not the right one."""
    said: tuple[int, ...] = (0,) * LEGS
    """Tick in which it last said whether it is enabled."""
    owed: tuple[int, ...] = (0,) * LEGS
    """Polls that a drive that is heard has not answered, RESTART_TICKS at most."""
    patience_ticks: int = NEVER
    """After which a drive that does not say so is in BOOT: nobody knows what it does."""
