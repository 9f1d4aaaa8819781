"""The drives' end of a protocol with drives that are set up wrongly: node numbers, watchdogs, presence."""

from collections.abc import Sequence
from math import isinf
from typing import Any

import numpy as np

from drivers.arrays import Array, Ints
from drivers.protocol import (
    Alive,
    Answer,
    Configure,
    DeviceCommand,
    DeviceMessage,
    DriveProtocol,
    EmergencyStop,
    Frame,
    Memory,
    Status,
    Sync,
)
from drivers.signals import LEGS
from plant_fmu.rehearsal.wiring import OWN, Wiring

NEVER_S = 1e6
"""What a drive without a watchdog adds to the time that it was told."""
HEARTBEAT = 0x700
"""CiA 301: identifier of a heartbeat less the node number."""
PRE_OPERATIONAL = b"\x7f"


class WiredDrives:
    """A drive protocol whose drives' end is that of a wiring; the controller's end is not to be used.

    What drives remember is by the number that they answer to: two with one number share it.
    """

    def __init__(self, protocol: DriveProtocol, wiring: Wiring, node_ids: Sequence[int]) -> None:
        self._protocol = protocol
        self._wiring = wiring
        self._node_ids = tuple(node_ids)
        self._plain = wiring.answers_as == OWN and all(wiring.present) and not any(wiring.other_protocol)
        """Each drive answers, and under its own number."""
        self._right = self._plain and set(wiring.watchdog) == {1.0}
        """Each drive hears what it is told, as it is told."""
        self._mute = {k for k in range(LEGS) if not wiring.present[k] or wiring.other_protocol[k]}

    @property
    def unasked_s(self) -> float:
        """As the family's."""
        return self._protocol.unasked_s

    def power_up(self) -> Memory:
        """Return the memory of six drives that have heard nothing."""
        return self._protocol.power_up()

    def parse(self, memory: Memory, frame: Frame) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode what a frame says to the drives that believe it to be theirs."""
        memory, messages = self._protocol.parse(memory, frame)
        if self._right:
            return memory, messages
        return memory, tuple(each for message in messages for each in self._heard(message))

    def _heard(self, message: DeviceMessage) -> list[DeviceMessage]:
        match message:
            case DeviceCommand(legs=legs, force=force):
                takes = self._takers(legs)
                forces = np.array([force[legs.index(self._wiring.answers_as[k])] for k in takes], float)
                return [message._replace(legs=tuple(takes), force=forces)] if takes else []
            case Configure(leg=leg):
                return [
                    Configure(k, self._waits(k, message.watchdog_s), message.reaction)
                    for k in self._takers((leg,))
                ]
            case Sync(legs=legs) | Alive(legs=legs) | EmergencyStop(legs=legs):
                takes = self._takers(legs)
                return [message._replace(legs=tuple(takes))] if takes else []
            case Answer(leg=leg):
                return [message] if leg in self._takers((leg,)) else []
            case _:
                return [message]

    def _takers(self, legs: Sequence[int]) -> list[int]:
        """Return the drives that take a frame to `legs` for theirs."""
        return [k for k in range(LEGS) if self._wiring.answers_as[k] in legs and k not in self._mute]

    def _waits(self, drive: int, watchdog_s: float) -> float:
        factor = self._wiring.watchdog[drive]
        return watchdog_s + NEVER_S if isinf(factor) else watchdog_s * factor

    def _told(self, drive: int, watchdog_s: float) -> float:
        """Return what the drive was told that waits so long: it confirms that."""
        factor = self._wiring.watchdog[drive]
        return round(watchdog_s - NEVER_S, 9) if isinf(factor) else watchdog_s / factor

    def answer(
        self,
        memory: Memory,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[Memory, list[tuple[int, Frame]]]:
        """Encode what the drives answer, each under the number that it was given."""
        if self._plain:
            return self._protocol.answer(memory, sync, length, rate, force, state, fault)
        frames = []
        for drive in sync.legs:
            if drive in self._mute:
                continue
            as_leg = self._wiring.answers_as[drive]
            length_, rate_, force_, state_ = (
                _moved(each, as_leg, drive) for each in (length, rate, force, state)
            )
            code = None if fault is None else _moved(fault, as_leg, drive)
            said = sync._replace(legs=(as_leg,))
            memory, answers = self._protocol.answer(memory, said, length_, rate_, force_, state_, code)
            frames += [(drive, frame) for leg, frame in answers if leg == as_leg]
        return memory, frames

    def report(self, memory: Memory, status: Status) -> tuple[Memory, tuple[Frame, ...]]:
        """Encode one drive's heartbeat, which confirms what the drive was told."""
        drive = status.leg
        if self._wiring.other_protocol[drive]:
            return memory, (Frame(HEARTBEAT + self._node_ids[drive], PRE_OPERATIONAL),)
        if not self._wiring.present[drive]:
            return memory, ()
        as_leg, holds = self._wiring.answers_as[drive], status.set_up
        if holds is not None:
            holds = Configure(as_leg, self._told(drive, holds.watchdog_s), holds.reaction)
        return self._protocol.report(memory, status._replace(leg=as_leg, set_up=holds))

    def restarted(self, memory: Memory, legs: Sequence[int]) -> Memory:
        """Return the memory after drives were switched off and on."""
        return self._protocol.restarted(memory, [self._wiring.answers_as[k] for k in legs])


def _moved(values: Any, to: int, drive: int) -> Any:
    moved = values.copy()
    moved[to] = values[drive]
    return moved
