"""Faults of a bus as a whole."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.cia402.set_up import Cia402Dialogue
from drivers.cia402.states import State
from drivers.config import MAX_BUSES
from drivers.motors import MotorDialogue
from drivers.protocol import BUS, Dialogue, DriveProtocol, DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode, DriveState
from plant_fmu.faults.fault import LastingFault, Passage, Passed, Place, Present

BusIndex = Annotated[int, Field(ge=0, lt=MAX_BUSES)]
_DATA = bytes(8)
EVERY_BUS = (1 << MAX_BUSES) - 1


class BusOff(Passage):
    """No frame passes in either direction; in lockstep the controller's interface reports bus off."""

    kind: Literal["bus_off"] = "bus_off"
    bus: BusIndex | None = None
    """Place in `bus.channels`, from 0; default: every bus."""

    def act(self, present: Present) -> None:
        """Cut the bus."""
        present.bus_off |= EVERY_BUS if self.bus is None else 1 << self.bus

    def concerns(self, frame: Frame) -> bool:
        """Tell whether a frame is on the bus that is cut."""
        return self.bus in (None, frame.bus)

    def carry(self, t_ns: int, frame: Frame, place: Place, passed: Passed) -> list[tuple[int, Frame]]:
        """Lose every frame."""
        del t_ns, frame, place, passed
        return []


class SenderFault(LastingFault):
    """A node that should not be there sends at its own rate. Both ends hear it."""

    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    bus: BusIndex = 0
    """Place in `bus.channels` of the bus that it is on, from 0."""

    def frames(self, protocol: DriveProtocol, number: int) -> tuple[Frame, ...]:
        """Return what it sends the n-th time."""
        raise NotImplementedError


class BusFlood(SenderFault):
    """Frames of 8 bytes under an identifier that wins against all others."""

    kind: Literal["bus_flood"] = "bus_flood"
    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 8000.0
    identifier: Annotated[int, Field(ge=0, le=0x7FF)] = 0

    def frames(self, protocol: DriveProtocol, number: int) -> tuple[Frame, ...]:
        """Return one frame."""
        del protocol, number
        return (Frame(self.identifier, _DATA, BUS * self.bus),)


class BusSecondController(SenderFault):
    """A second controller: SYNC, then a command of RUN with this force in each leg."""

    kind: Literal["bus_second_controller"] = "bus_second_controller"
    force_N: float = 0.0

    def frames(self, protocol: DriveProtocol, number: int) -> tuple[Frame, ...]:
        """Return what starts its tick, and its command; where the poll is the command, that alone."""
        frames = forged(protocol, self.force_N, number)
        if not protocol.command_delay_ticks:
            frames = protocol.begin(_dialogue(protocol), number) + frames
        return tuple(frame for frame in frames if frame.bus == self.bus)


def forged(protocol: DriveProtocol, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Return a stranger's command of a tick: RUN, the same force in each leg.

    He takes all drives for enabled. Raises ProtocolError if the force does not fit.
    """
    dialogue = _dialogue(protocol)
    if isinstance(dialogue, Cia402Dialogue):
        dialogue = dialogue._replace(states=(State.ENABLED,) * LEGS)
    elif isinstance(dialogue, MotorDialogue):
        dialogue = dialogue._replace(power=(int(DriveState.RUN),) * LEGS)
    dialogue, frames = protocol.command(dialogue, Command(DriveMode.RUN, np.full(LEGS, force_N)), tick)
    return protocol.begin(dialogue, tick) if protocol.command_delay_ticks else frames


def _dialogue(protocol: DriveProtocol) -> Dialogue:
    """Return that of a controller that has heard nothing."""
    return protocol.start(DriveSetup(0.01, protocol.reactions[0], 1000.0))
