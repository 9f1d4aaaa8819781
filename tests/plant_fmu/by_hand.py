"""Drives that are moved by hand: the parts of the compiled pass, called in Python."""

from types import SimpleNamespace

import numpy as np

from drivers.arrays import Array, Ints
from plant_fmu.drives import kernels
from plant_fmu.drives.drive import Drives
from plant_fmu.drives.ends import COMMAND, UNWATCHED
from plant_fmu.drives.kernels import NEVER_NS


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
    """Give drives a command: whether it was new and one controls by itself, legs that entered a state, and
    the earliest instant at which a watchdog ends or a brake has moved."""
    n = drives.seen
    n.length, n.rate, n.calm_ns, n.commands = length, rate, NEVER_NS, 0
    command = SimpleNamespace(count=len(legs), legs=legs, force=force, mode=mode, counter=counter)
    command.kind = COMMAND if feeds else UNWATCHED
    entered = kernels.obey(n, command, t_ns)
    return bool(n.commands), bool(n.controls), entered, int(n.calm_ns)


def actuate(drives: Drives, length: Array, rate: Array, lag: bool, t_ns: int) -> bool:
    """Let drives act; tell whether one controls by itself."""
    drives.seen.length, drives.seen.rate = length, rate
    kernels.actuate(drives.seen, lag, t_ns)
    return bool(drives.seen.controls)


def encoders(drives: Drives, length: Array, rate: Array, dt_s: float = 0.0) -> tuple[Array, Array, Ints]:
    """Return what is read: m, m/s, state."""
    drives.seen.length, drives.seen.rate = length, rate
    l, dl, state = np.empty(6), np.empty(6), np.empty(6, np.int64)
    kernels.encoders(drives.seen, dt_s, l, dl, state)
    return l, dl, state


def enter(drives: Drives, leg: int, state: int, reason: int) -> None:
    """Move one drive to a state."""
    kernels.enter(drives.seen, leg, state, reason)


def next_move_ns(drives: Drives) -> int:
    """Return when the next brake has moved."""
    return kernels.next_move_ns(drives.seen)
