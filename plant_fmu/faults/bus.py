"""Faults of a bus as a whole."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.config import MAX_BUSES
from drivers.protocol import BUS, DriveProtocol, Frame
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
        from plant_fmu.faults.stranger import opened  # noqa: PLC0415 - compiled code: not for who only reads a configuration

        return tuple(frame for frame in opened(protocol, self.force_N, number) if frame.bus == self.bus)
