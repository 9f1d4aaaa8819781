"""The kinds of faults: of encoders, drives and brakes, of frames and buses, of the process, of the plant."""

from operator import add, mul
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from drivers.config import MAX_BUSES
from drivers.family import Family
from drivers.protocol import BUS, Frame
from drivers.signals import LEGS
from plant_fmu.faults.fault import (
    Fault,
    FrameFault,
    LastingFault,
    LegFault,
    Occurrence,
    Passage,
    Place,
    Present,
    last,
    later,
)

BusIndex = Annotated[int, Field(ge=0, lt=MAX_BUSES)]
_DATA = bytes(8)
EVERY_BUS = (1 << MAX_BUSES) - 1
Vector = tuple[float, float, float]


class EncoderJump(LegFault, kind="encoder_jump", effect=("offset_m", add, "by_m")):
    """The encoder slips: from now on it reads this much more than the length."""

    by_m: float


class EncoderFreeze(LegFault, kind="encoder_freeze", effect=("frozen", last, True)):
    """The encoder keeps the length of the moment the fault begins, at rate zero."""


class EncoderDrift(LegFault, kind="encoder_drift", effect=("drifts", None, "by_m_s")):
    """The encoder creeps away: its length at this rate, which its rate contains."""

    by_m_s: float


class EncoderNoise(LegFault, kind="encoder_noise"):
    """White noise on the length that is sent."""

    sigma_m: Annotated[float, Field(ge=0)]
    """Standard deviation."""
    seed: Annotated[int, Field(ge=0)] = 0

    def act(self, present: Present) -> None:
        """Several noises add up."""
        present.noise.append((self.leg, self.sigma_m, present.generator))


class EncoderLate(LegFault, kind="encoder_late", effect=("late_ns", later, "by_ms")):
    """What is sent is the length and rate of so long ago; at first it stands still for as long."""

    by_ms: Annotated[float, Field(gt=0, le=1000)] = 1.0


class EncoderScale(LegFault, kind="encoder_scale", effect=("scales", None, "factor")):
    """The encoder counts this multiple of the motion since the fault began; its rate is scaled as well."""

    factor: float


class EncoderSign(LegFault, kind="encoder_sign", effect=("scales", None, -1.0)):
    """The encoder counts backwards from where it is when the fault begins."""


class EncoderLost(LegFault, kind="encoder_lost", effect=("lost", last, True)):
    """The drive knows that its encoder is lost: it says so in its feedback, and still obeys."""


class DriveSilence(LegFault, kind="drive_silence", effect=("silent", last, True)):
    """The drive sends nothing. It still hears."""


class DriveReset(Fault, kind="drive_reset", effect=("reset", last, True)):
    """The drive starts anew at this instant: it is in BOOT, its brake closes, its set-up is forgotten."""

    leg: Annotated[int, Field(ge=0, lt=LEGS)]


class DriveGain(LegFault, kind="drive_gain", effect=("gain", mul, "factor")):
    """The leg's force is this multiple of what its drive means to apply."""

    factor: float


class DriveSign(LegFault, kind="drive_sign", effect=("gain", mul, -1.0)):
    """The leg's force has the wrong sign, as with swapped wires."""


class DriveSaturation(LegFault, kind="drive_saturation", effect=("saturation_N", min, "limit_N")):
    """The drive gives no more force than this."""

    limit_N: Annotated[float, Field(ge=0)]


class BrakeStuckOpen(LegFault, kind="brake_stuck_open", effect=("stuck", last, False)):
    """The brake is released, whatever the drive wants."""


class BrakeStuckClosed(LegFault, kind="brake_stuck_closed", effect=("stuck", last, True)):
    """The brake is engaged, whatever the drive wants."""


class BrakeSlow(LegFault, kind="brake_slow", effect=("slow_ns", later, "by_ms")):
    """The brake opens and closes this much later than its drive counts."""

    by_ms: Annotated[float, Field(gt=0, le=10_000)]


class BrakeSlipping(LegFault, kind="brake_slipping", effect=("share", mul, "share")):
    """The engaged brake holds only this share of its force."""

    share: Annotated[float, Field(ge=0, le=1)]


BRAKES = (BrakeStuckOpen, BrakeStuckClosed, BrakeSlipping)
"""What is of the plant's brake alone."""


class FramesLoss(FrameFault, kind="frames_loss"):
    """The frame never arrives."""

    copies: ClassVar[int] = 0


class FramesDuplicate(FrameFault, kind="frames_duplicate"):
    """The frame arrives twice."""

    copies: ClassVar[int] = 2


class FramesDelay(FrameFault, kind="frames_delay"):
    """The frame arrives later."""

    by_ms: Annotated[float, Field(gt=0, le=1000)]

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Delay it."""
        return super().strike(t_ns + round(self.by_ms * 1e6), frame, generator)


class FramesReorder(FrameFault, kind="frames_reorder"):
    """The frame arrives after the next one of its identifier on its bus."""

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Hold a frame back that is struck, until the next one has own."""
        held = own.frames.pop(place, [])
        if not held and own.generator.random() < self.probability:
            own.frames[place] = [frame]
            return []
        return [(t_ns, each) for each in (frame, *held)]


class FramesCorrupt(FrameFault, kind="frames_corrupt"):
    """One bit of the data is flipped behind the back of the bus' own check, as a bad gateway does."""

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Flip one bit of any; an empty frame passes."""
        if not frame.data:
            return [(t_ns, frame)]
        bit = int(generator.integers(8 * len(frame.data)))
        data = bytearray(frame.data)
        data[bit // 8] ^= 1 << bit % 8
        return [(t_ns, frame._replace(data=bytes(data)))]


class FramesForgedCommand(LastingFault, kind="frames_forged_command"):
    """A third node answers every SYNC with a command of its own: RUN, this force in each leg, valid checks.

    Both ends hear it; it is there before the controller's.
    """

    force_N: float = 0.0


class FramesForgedFeedback(LegFault, kind="frames_forged_feedback", effect=("forged_m", last, "by_m")):
    """A second node of the leg's number answers every SYNC: the leg is this much longer, valid checks."""

    by_m: float


class FramesOld(FrameFault, kind="frames_old"):
    """A third node sends an older frame of the same identifier and bus after the frame. Both ends hear it."""

    adds: ClassVar[bool] = True
    back: Annotated[int, Field(ge=1, le=1000)] = 2
    """How many frames of this identifier ago, on its bus."""

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Remember the frame, and repeat an older one at random."""
        seen = own.frames.setdefault(place, [])
        seen.append(frame)
        if len(seen) <= self.back:
            return [(t_ns, frame)]
        old = seen.pop(0)
        struck = own.generator.random() < self.probability
        return [(t_ns, frame), (t_ns, old)] if struck else [(t_ns, frame)]


class BusOff(Passage, kind="bus_off"):
    """No frame passes in either direction; in lockstep the controller's interface reports bus off."""

    bus: BusIndex | None = None
    """Place in `bus.channels`, from 0; default: every bus."""

    def act(self, present: Present) -> None:
        """Cut the bus."""
        present.bus_off |= EVERY_BUS if self.bus is None else 1 << self.bus

    def carry(self, _t_ns: int, _frame: Frame, _place: Place, _own: Occurrence) -> list[tuple[int, Frame]]:
        """Lose every frame."""
        return []


class SenderFault(LastingFault):
    """A node that should not be there sends at its own rate. Both ends hear it."""

    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    bus: BusIndex = 0
    """Place in `bus.channels` of the bus that it is on, from 0."""

    def frames(self, protocol: Family, number: int) -> tuple[Frame, ...]:
        """Return what it sends the n-th time."""
        raise NotImplementedError


class BusFlood(SenderFault, kind="bus_flood"):
    """Frames of 8 bytes under an identifier that wins against all others."""

    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 8000.0
    identifier: Annotated[int, Field(ge=0, le=0x7FF)] = 0

    def frames(self, _protocol: Family, _number: int) -> tuple[Frame, ...]:
        """Return one frame."""
        return (Frame(self.identifier, _DATA, BUS * self.bus),)


class BusSecondController(SenderFault, kind="bus_second_controller"):
    """A second controller: SYNC, then a command of RUN with this force in each leg."""

    force_N: float = 0.0

    def frames(self, protocol: Family, number: int) -> tuple[Frame, ...]:
        """Return what starts its tick, and its command; where the poll is the command, that alone."""
        from plant_fmu.faults.stranger import opened  # noqa: PLC0415 - compiled code: not for who only reads a configuration

        return tuple(frame for frame in opened(protocol, self.force_N, number) if frame.bus == self.bus)


class ProcessKill(Fault, kind="process_kill"):
    """The process is killed (SIGKILL): its drives fall silent and its log is cut."""


class ProcessStop(Fault, kind="process_stop"):
    """The process is stopped (SIGSTOP) and continued after `for_s`."""

    for_s: Annotated[float, Field(gt=0, le=3600)]
    """How long it is stopped."""


class ProcessSlow(LastingFault, kind="process_slow"):
    """The process takes this much longer for every round of its loop."""

    by_ms: Annotated[float, Field(gt=0, le=1000)]


PROCESS = (ProcessKill, ProcessStop, ProcessSlow)
"""What a simulated plant does not have."""


class PlantNaN(LastingFault, kind="plant_nan", effect=("not_finite", last, True)):
    """The plant's lengths are not numbers."""


class PlantHang(LastingFault, kind="plant_hang", effect=("hangs", last, True)):
    """The plant does not come back from a step: no drive answers; what it has missed it catches up with."""


class PlantCrash(Fault, kind="plant_crash", effect=("crashes", last, True)):
    """The plant fails at this instant, and its drives with it."""


class WrenchStep(LastingFault, kind="wrench_step"):
    """A wrench on the platform at its origin, base frame."""

    force_N: Vector = (0.0, 0.0, 0.0)
    moment_N_m: Vector = (0.0, 0.0, 0.0)

    def act(self, present: Present) -> None:
        """Several wrenches add up."""
        present.wrench += (*self.force_N, *self.moment_N_m)


class PayloadStep(LastingFault, kind="payload_step"):
    """The weight of a mass on the platform; its inertia is not emulated."""

    mass_kg: Annotated[float, Field(gt=0)]
    position_m: Vector = (0.0, 0.0, 0.0)
    """Where the mass lies, platform frame."""

    def act(self, present: Present) -> None:
        """Several masses add up."""
        present.masses.append((self.mass_kg, np.array(self.position_m)))


LOADS = (WrenchStep, PayloadStep)
"""What needs a platform."""
