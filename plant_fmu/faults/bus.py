"""Faults of the bus as a whole."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.protocol import Dialogue, DriveProtocol, DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode, Reaction
from plant_fmu.faults.fault import LastingFault, Passage, Passed, Place, Present

_SETUP = DriveSetup(0.01, Reaction.BRAKE, 1000.0)
_DATA = bytes(8)


class BusOff(Passage):
    """No frame passes in either direction; in lockstep the controller's interface reports bus off."""

    kind: Literal["bus_off"] = "bus_off"

    def act(self, present: Present) -> None:
        """Cut the bus."""
        present.bus_off = True

    def carry(self, t_ns: int, frame: Frame, place: Place, passed: Passed) -> list[tuple[int, Frame]]:
        """Lose every frame."""
        del t_ns, frame, place, passed
        return []


class SenderFault(LastingFault):
    """A node that should not be there sends at its own rate. Both ends hear it."""

    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 1000.0

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
        return (Frame(self.identifier, _DATA),)


class BusSecondController(SenderFault):
    """A second controller: SYNC, then a command of RUN with this force in each leg."""

    kind: Literal["bus_second_controller"] = "bus_second_controller"
    force_N: float = 0.0

    def frames(self, protocol: DriveProtocol, number: int) -> tuple[Frame, ...]:
        """Return what starts its tick, and its command."""
        dialogue = protocol.start(_SETUP)
        return protocol.begin(dialogue, number) + command(protocol, dialogue, self.force_N, number)


def command(protocol: DriveProtocol, dialogue: Dialogue, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Return a foreign command of a tick: RUN, the same force in each leg."""
    return protocol.command(dialogue, Command(DriveMode.RUN, np.full(LEGS, force_N)), tick)[1]


def forged(protocol: DriveProtocol, force_N: float, counter: int) -> tuple[Frame, ...]:
    """Return the command of a forger to a SYNC."""
    return command(protocol, protocol.start(_SETUP), force_N, counter)
