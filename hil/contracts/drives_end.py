"""Frames of emulated drives that have just been switched on, for tests of protocols."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array, Ints
from drivers.protocol import Frame
from hil.contracts.messages import DeviceCommand, DeviceMessage, Status, Sync, announce, reply
from plant_fmu.drives import drives_end
from plant_fmu.drives.codec import READING


def answers(
    protocol: Any, sync: Sync, length: Array, rate: Array, force: Array, state: Ints
) -> list[tuple[int, Frame]]:
    """Answers (leg, frame) of drives just switched on to a SYNC or poll, for readings (6,) m, m/s, N."""
    return reply(drives_end(protocol), sync, reading_of(length, rate, force, state))


def reading_of(length: Array, rate: Array, force: Array, state: Ints, fault: Ints | int = 0) -> Any:
    """Readings of six drives, length (6,) m, rate (6,) m/s, force (6,) N, state and fault, as one record."""
    reading: Any = np.zeros((), READING)
    reading[()] = length, rate, force, state, fault
    return reading


def reports(protocol: Any, status: Status) -> tuple[Frame, ...]:
    """Frames in which a drive just switched on reports its status."""
    return announce(drives_end(protocol), status)


def memory_of(end: Any) -> Any:
    """Copy of the state that a protocol's drives' end keeps for six drives."""
    return getattr(end, "memory", None) or end.state.copy()


def go_back(end: Any, before: Any) -> None:
    """Restore a state that `memory_of` returned."""
    if hasattr(end, "memory"):
        end.memory = before
    else:
        end.state[...] = before


def plain(messages: Sequence[DeviceMessage]) -> tuple[DeviceMessage, ...]:
    """Messages with forces as lists rounded to 1e-6 N, so that they can be compared with ==."""
    return tuple(
        each._replace(force=[round(float(f), 6) for f in each.force])  # type: ignore[arg-type]
        if isinstance(each, DeviceCommand)
        else each
        for each in messages
    )


def command(leg: int, mode: int, counter: int, force: float = 0.0) -> DeviceMessage:
    """Command of a force, N, for one leg, in the comparable form of `plain`."""
    return DeviceCommand((leg,), int(mode), [round(force, 6)], counter)  # type: ignore[arg-type]
