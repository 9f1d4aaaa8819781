"""Drives that are moved by hand: the parts of the compiled pass, called in Python."""

from typing import Any

from drivers.arrays import Array, Ints
from plant_fmu.drives import kernels
from plant_fmu.drives.drive import Drives


def obey(
    drives: Drives,
    length: Array,
    rate: Array,
    legs: Ints,
    force: Array,
    mode: int,
    counter: int,
    t_ns: int,
    *,
    feeds: bool = True,
) -> tuple[bool, bool, int, int]:
    """Give drives a command; see `kernels.obey`."""
    return kernels.obey(*drives.matrices, length, rate, legs, force, mode, counter, feeds, t_ns)


def actuate(drives: Drives, *given: Any) -> bool:
    """Let drives act; see `kernels.actuate`."""
    return kernels.actuate(*drives.matrices, *given)


def next_move_ns(drives: Drives) -> int:
    """Return when the next brake has moved."""
    return kernels.next_move_ns(drives.matrices[0])
