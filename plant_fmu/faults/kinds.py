"""Faults of brakes, drives, encoders and plant, of the plant's process, and loads on the platform."""

from operator import add, mul
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drivers.signals import LEGS
from plant_fmu.faults.fault import Fault, LastingFault, LegFault, Present, joins, last, later


class BrakeStuckOpen(LegFault):
    """The brake is released, whatever the drive wants."""

    kind: Literal["brake_stuck_open"] = "brake_stuck_open"
    act = joins("stuck", last, False)


class BrakeStuckClosed(LegFault):
    """The brake is engaged, whatever the drive wants."""

    kind: Literal["brake_stuck_closed"] = "brake_stuck_closed"
    act = joins("stuck", last, True)


class BrakeSlow(LegFault):
    """The brake opens and closes this much later than its drive counts."""

    kind: Literal["brake_slow"] = "brake_slow"
    by_ms: Annotated[float, Field(gt=0, le=10_000)]
    act = joins("slow_ns", later, "by_ms")


class BrakeSlipping(LegFault):
    """The engaged brake holds only this share of its force."""

    kind: Literal["brake_slipping"] = "brake_slipping"
    share: Annotated[float, Field(ge=0, le=1)]
    act = joins("share", mul, "share")


BRAKES = (BrakeStuckOpen, BrakeStuckClosed, BrakeSlipping)
"""What is of the plant's brake alone."""


class DriveSilence(LegFault):
    """The drive sends nothing. It still hears."""

    kind: Literal["drive_silence"] = "drive_silence"
    act = joins("silent", last, True)


class DriveReset(Fault):
    """The drive starts anew at this instant: it is in BOOT, its brake closes, its set-up is forgotten."""

    kind: Literal["drive_reset"] = "drive_reset"
    leg: Annotated[int, Field(ge=0, lt=LEGS)]
    act = joins("reset", last, True)


class DriveGain(LegFault):
    """The leg's force is this multiple of what its drive means to apply."""

    kind: Literal["drive_gain"] = "drive_gain"
    factor: float
    act = joins("gain", mul, "factor")


class DriveSign(LegFault):
    """The leg's force has the wrong sign, as with swapped wires."""

    kind: Literal["drive_sign"] = "drive_sign"
    act = joins("gain", mul, -1.0)


class DriveSaturation(LegFault):
    """The drive gives no more force than this."""

    kind: Literal["drive_saturation"] = "drive_saturation"
    limit_N: Annotated[float, Field(ge=0)]
    act = joins("saturation_N", min, "limit_N")


class EncoderJump(LegFault):
    """The encoder slips: from now on it reads this much more than the length."""

    kind: Literal["encoder_jump"] = "encoder_jump"
    by_m: float
    act = joins("offset_m", add, "by_m")


class EncoderFreeze(LegFault):
    """The encoder keeps the length of the moment the fault begins, at rate zero."""

    kind: Literal["encoder_freeze"] = "encoder_freeze"
    act = joins("frozen", last, True)


class EncoderDrift(LegFault):
    """The encoder creeps away: its length at this rate, which its rate contains."""

    kind: Literal["encoder_drift"] = "encoder_drift"
    by_m_s: float

    def act(self, present: Present) -> None:
        """Several drifts add up."""
        present.drifts.append((self.leg, self.by_m_s, present.since_ns))


class EncoderNoise(LegFault):
    """White noise on the length that is sent."""

    kind: Literal["encoder_noise"] = "encoder_noise"
    sigma_m: Annotated[float, Field(ge=0)]
    """Standard deviation."""
    seed: Annotated[int, Field(ge=0)] = 0

    def act(self, present: Present) -> None:
        """Several noises add up."""
        present.noise.append((self.leg, self.sigma_m, present.generator))


class EncoderLate(LegFault):
    """What is sent is the length and rate of so long ago; at first it stands still for as long."""

    kind: Literal["encoder_late"] = "encoder_late"
    by_ms: Annotated[float, Field(gt=0, le=1000)] = 1.0
    act = joins("late_ns", later, "by_ms")


class EncoderScale(LegFault):
    """The encoder counts this multiple of the motion since the fault began; its rate is scaled as well."""

    kind: Literal["encoder_scale"] = "encoder_scale"
    factor: float

    def act(self, present: Present) -> None:
        """Several factors multiply."""
        present.scales.append((self.leg, self.factor, present.since_ns))


class EncoderSign(LegFault):
    """The encoder counts backwards from where it is when the fault begins."""

    kind: Literal["encoder_sign"] = "encoder_sign"

    def act(self, present: Present) -> None:
        """Turn it round."""
        present.scales.append((self.leg, -1.0, present.since_ns))


class EncoderLost(LegFault):
    """The drive knows that its encoder is lost: it says so in its feedback, and still obeys."""

    kind: Literal["encoder_lost"] = "encoder_lost"
    act = joins("lost", last, True)


class PlantNaN(LastingFault):
    """The plant's lengths are not numbers."""

    kind: Literal["plant_nan"] = "plant_nan"

    def act(self, present: Present) -> None:
        """Spoil the lengths."""
        present.not_finite = True


class PlantHang(LastingFault):
    """The plant does not come back from a step: no drive answers; what it has missed it catches up with."""

    kind: Literal["plant_hang"] = "plant_hang"

    def act(self, present: Present) -> None:
        """Let it hang."""
        present.hangs = True


class PlantCrash(Fault):
    """The plant fails at this instant, and its drives with it."""

    kind: Literal["plant_crash"] = "plant_crash"

    def act(self, present: Present) -> None:
        """Let it fail."""
        present.crashes = True


class ProcessKill(Fault):
    """The process is killed (SIGKILL): its drives fall silent and its log is cut."""

    kind: Literal["process_kill"] = "process_kill"


class ProcessStop(Fault):
    """The process is stopped (SIGSTOP) and continued after `for_s`."""

    kind: Literal["process_stop"] = "process_stop"
    for_s: Annotated[float, Field(gt=0, le=3600)]
    """How long it is stopped."""


class ProcessSlow(LastingFault):
    """The process takes this much longer for every round of its loop."""

    kind: Literal["process_slow"] = "process_slow"
    by_ms: Annotated[float, Field(gt=0, le=1000)]


PROCESS = (ProcessKill, ProcessStop, ProcessSlow)
"""What a simulated plant does not have."""


Vector = tuple[float, float, float]


class WrenchStep(LastingFault):
    """A wrench on the platform at its origin, base frame."""

    kind: Literal["wrench_step"] = "wrench_step"
    force_N: Vector = (0.0, 0.0, 0.0)
    moment_N_m: Vector = (0.0, 0.0, 0.0)

    def act(self, present: Present) -> None:
        """Several wrenches add up."""
        present.wrench += (*self.force_N, *self.moment_N_m)


class PayloadStep(LastingFault):
    """The weight of a mass on the platform; its inertia is not emulated."""

    kind: Literal["payload_step"] = "payload_step"
    mass_kg: Annotated[float, Field(gt=0)]
    position_m: Vector = (0.0, 0.0, 0.0)
    """Where the mass lies, platform frame."""

    def act(self, present: Present) -> None:
        """Several masses add up."""
        present.masses.append((self.mass_kg, np.array(self.position_m)))


LOADS = (WrenchStep, PayloadStep)
"""What needs a platform."""
