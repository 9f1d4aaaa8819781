"""Faults of frames on their way (lost, doubled, late, out of order, damaged, forged, old) and of a bus."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.config import MAX_BUSES
from drivers.protocol import BUS, DriveProtocol, Frame
from plant_fmu.faults.fault import (
    FrameFault,
    LastingFault,
    LegFault,
    Passage,
    Passed,
    Place,
    Present,
    joins,
    last,
)


class FramesLoss(FrameFault):
    """The frame never arrives."""

    kind: Literal["frames_loss"] = "frames_loss"

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Lose it."""
        del t_ns, frame, generator
        return []


class FramesDuplicate(FrameFault):
    """The frame arrives twice."""

    kind: Literal["frames_duplicate"] = "frames_duplicate"

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Double it."""
        del generator
        return [(t_ns, frame)] * 2


class FramesDelay(FrameFault):
    """The frame arrives later."""

    kind: Literal["frames_delay"] = "frames_delay"
    by_ms: Annotated[float, Field(gt=0, le=1000)]

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Delay it."""
        del generator
        return [(t_ns + round(self.by_ms * 1e6), frame)]


class FramesReorder(FrameFault):
    """The frame arrives after the next one of its identifier on its bus."""

    kind: Literal["frames_reorder"] = "frames_reorder"

    def carry(self, t_ns: int, frame: Frame, place: Place, passed: Passed) -> list[tuple[int, Frame]]:
        """Hold a frame back that is struck, until the next one has passed."""
        held = passed.frames.pop(place, [])
        if not held and passed.generator.random() < self.probability:
            passed.frames[place] = [frame]
            return []
        return [(t_ns, each) for each in (frame, *held)]


class FramesCorrupt(FrameFault):
    """One bit of the data is flipped behind the back of the bus' own check, as a bad gateway does."""

    kind: Literal["frames_corrupt"] = "frames_corrupt"

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Flip one bit of any; an empty frame passes."""
        if not frame.data:
            return [(t_ns, frame)]
        bit = int(generator.integers(8 * len(frame.data)))
        data = bytearray(frame.data)
        data[bit // 8] ^= 1 << bit % 8
        return [(t_ns, frame._replace(data=bytes(data)))]


class FramesOld(FrameFault):
    """A third node sends an older frame of the same identifier and bus after the frame. Both ends hear it."""

    kind: Literal["frames_old"] = "frames_old"
    adds: ClassVar[bool] = True
    back: Annotated[int, Field(ge=1, le=1000)] = 2
    """How many frames of this identifier ago, on its bus."""

    def carry(self, t_ns: int, frame: Frame, place: Place, passed: Passed) -> list[tuple[int, Frame]]:
        """Remember the frame, and repeat an older one at random."""
        seen = passed.frames.setdefault(place, [])
        seen.append(frame)
        if len(seen) <= self.back:
            return [(t_ns, frame)]
        old = seen.pop(0)
        struck = passed.generator.random() < self.probability
        return [(t_ns, frame), (t_ns, old)] if struck else [(t_ns, frame)]


class FramesForgedCommand(LastingFault):
    """A third node answers every SYNC with a command of its own: RUN, this force in each leg, valid checks.

    Both ends hear it; it is there before the controller's.
    """

    kind: Literal["frames_forged_command"] = "frames_forged_command"
    force_N: float = 0.0


class FramesForgedFeedback(LegFault):
    """A second node of the leg's number answers every SYNC: the leg is this much longer, valid checks."""

    kind: Literal["frames_forged_feedback"] = "frames_forged_feedback"
    by_m: float
    act = joins("forged_m", last, "by_m")


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
