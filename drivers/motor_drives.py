"""The drives' end of the families of single-motor drives: what such drives remember and send. Pure.

The controller's end is `drivers.motors`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Ints
from drivers.errors import ProtocolError
from drivers.protocol import DeviceCommand, DeviceMessage, Frame, Status, Sync
from drivers.signals import LEGS, DriveState
from drivers.transmission import Transmission


class MotorMemory(NamedTuple):
    """The drives' end; one element a leg."""

    heard: tuple[int, ...] = (0,) * LEGS
    """Commands so far: none is a repetition."""
    enabled: tuple[bool, ...] = (False,) * LEGS
    registers: tuple[tuple[tuple[int, float], ...], ...] = ((),) * LEGS
    """What has been written, by leg."""
    asked: tuple[tuple[int, tuple[tuple[int, int], ...]], ...] = ((0, ()),) * LEGS
    """Who wants what of each drive, in families where a query says so."""


def put(values: tuple[Any, ...], leg: int, value: Any) -> tuple[Any, ...]:
    """Return the values with another one for a leg."""
    return (*values[:leg], value, *values[leg + 1 :])


class MotorDrives(ABC):
    """What the drives' ends of all families share. Holds tables only."""

    def __init__(self, transmission: Transmission) -> None:
        self.transmission = transmission

    def power_up(self) -> MotorMemory:
        """Return the memory of six drives that have heard nothing."""
        return MotorMemory()

    def report(self, memory: MotorMemory, _status: Status) -> tuple[MotorMemory, tuple[Frame, ...]]:
        """Return nothing: such drives speak when they are asked."""
        return memory, ()

    def restarted(self, memory: MotorMemory, legs: Sequence[int]) -> MotorMemory:
        """Return the memory with drives that were switched off and on: disabled, nothing written in them."""
        fresh = self.power_up()
        for leg in legs:
            parts = zip(memory, fresh, strict=True)
            memory = MotorMemory(*(put(now, leg, new[leg]) for now, new in parts))
        return memory

    @abstractmethod
    def answer(
        self,
        memory: MotorMemory,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[MotorMemory, list[tuple[int, Frame]]]:
        """See `DriveProtocol.answer`."""

    def example_feedbacks(self) -> list[Frame]:
        """Return the feedbacks of six running drives at rest at position zero."""
        zeros, running = np.zeros(LEGS), np.full(LEGS, DriveState.RUN, np.int64)
        length = self.transmission.length(zeros)
        _, frames = self.answer(self.power_up(), Sync(0), length, zeros, zeros, running)
        return [frame for _, frame in frames]

    def _commanded(
        self, memory: MotorMemory, leg: int, modes: Sequence[int], torque: float
    ) -> tuple[MotorMemory, tuple[DeviceMessage, ...]]:
        """Return the commands of one frame to one drive, each new."""
        force = np.array([torque * self.transmission.N_per_Nm[leg]])
        count = memory.heard[leg]
        commands = tuple(DeviceCommand((leg,), int(m), force, count + n + 1) for n, m in enumerate(modes))
        return memory._replace(heard=put(memory.heard, leg, count + len(modes))), commands

    @staticmethod
    def finite(leg: int, *values: float) -> None:
        """Raise ProtocolError for a feedback that is no number."""
        if not all(map(isfinite, values)):
            raise ProtocolError(f"feedback of leg {leg} is not a number: {values}")

    def motor(self, length: Array, rate: Array, force: Array) -> tuple[list[float], list[float], list[float]]:
        """Return turns, turns/s and N m of the motors at lengths m, rates m/s, leg forces N, each (6,)."""
        t = self.transmission
        return t.turns(length).tolist(), t.turns_per_s(rate).tolist(), t.torque(force, rate).tolist()
