"""Measurement and Command: all that crosses the bus, in SI.

Arrays are treated as read-only by every reader.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Ints

LEGS = 6
NEVER = 1_000_000
"""Age in ticks of a leg that has never been heard."""


class DriveMode(IntEnum):
    """What the controller asks of all six drives."""

    OFF = 0
    """Force stage off, brake engaged."""
    READY = 1
    """Force stage on, brake still engaged: the static force can build up against it."""
    RUN = 2
    """Force stage on, brake released."""
    RESET = 3
    """Clear a latched drive fault, then OFF."""


class DriveState(IntEnum):
    """What one drive reports."""

    BOOT = 0
    """Powered up, not configured; brake engaged."""
    OFF = 1
    READY = 2
    RUN = 3
    FAULT = 4
    """Latched: the reaction is active until RESET; OFF brakes, and stays latched."""


INVALID = 8
"""Added to the state in a feedback whose length and rate are of no use: encoder lost, the drive obeys."""


class Reaction(IntEnum):
    """What a drive does by itself when it faults in RUN (its command stops, say).

    An emergency stop always brakes, and so does a fault outside RUN: no fault opens a closed brake.
    """

    BRAKE = 0
    """Force off, brake engaged."""
    DAMP = 1
    """Viscous force against the measured rate, brake open."""
    HOLD = 2
    """Local position hold at the length of the fault instant, brake open."""
    ZERO = 3
    """Force zero, brake open."""


class DriveFault(IntEnum):
    """Why a drive is in FAULT (status message)."""

    NONE = 0
    WATCHDOG = 1
    ESTOP = 2
    OVERFORCE = 3
    SENSOR = 4
    STROKE = 5


class Command(NamedTuple):
    """One tick's command to the six drives."""

    mode: DriveMode
    force: Array
    """(6,) N, > 0 extends the leg."""


NO_BLIND = np.zeros(LEGS, np.bool_)
NO_BLIND.flags.writeable = False


class Measurement(NamedTuple):
    """What the six drives say, as of this tick."""

    length: Array
    """(6,) m, joint centre to joint centre, latched at the SYNC of the tick it was fresh."""
    rate: Array
    """(6,) m/s."""
    force: Array
    """(6,) N, applied by the drive."""
    state: Ints
    """(6,) DriveState."""
    fault: Ints
    """(6,) DriveFault from the last status message."""
    age: Ints
    """(6,) ticks since the leg's last fresh feedback: 0 is this tick's SYNC, NEVER is none yet."""
    rejected: int
    """Frames of this tick that were refused: CRC, length, counter, time, value not finite."""
    tick: int = -1
    """The tick of this measurement; -1 before the first."""
    blind: Flags = NO_BLIND
    """(6,) this tick's feedback calls its length and rate of no use; force and state are this tick's."""


def no_measurement() -> Measurement:
    """Return the Measurement before any frame: zeros, BOOT, never heard."""
    return Measurement(
        length=np.zeros(LEGS),
        rate=np.zeros(LEGS),
        force=np.zeros(LEGS),
        state=np.zeros(LEGS, np.int64),
        fault=np.zeros(LEGS, np.int64),
        age=np.full(LEGS, NEVER, np.int64),
        rejected=0,
    )
