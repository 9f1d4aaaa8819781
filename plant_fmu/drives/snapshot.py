"""The plant's end at one instant."""

from typing import NamedTuple

from drivers.arrays import Array, Ints
from plant_fmu.plant import Truth


class Snapshot(NamedTuple):
    """The plant's end at one instant, for its log."""

    t_ns: int
    """Grid instant of length and rate."""
    length: Array
    """(6,) m, true."""
    rate: Array
    """(6,) m/s, true."""
    command: Array
    """(6,) N, last valid command."""
    force: Array
    """(6,) N, what the drives put on the plant."""
    applied: Array
    """(6,) N, the plant's own answer to that where it knows it, else `force`."""
    state: Ints
    """(6,) DriveState."""
    fault: Ints
    """(6,) DriveFault."""
    brake: Array
    """(6,) 1 engaged, 0 released."""
    wrench: Array
    """(6,) N, N m on the platform."""
    truth: Truth | None
    syncs: int
    """SYNC frames or polls heard since the start."""
    commands: int
    """Valid command frames with a new counter."""
    repeated: int
    """Valid command frames whose counter had been seen: they count for nothing."""
    rejected: int
    """Frames that could not be trusted, or were for another SYNC than the present one."""
