"""The kinds of faults: of encoders, drives and brakes, of frames and buses, of the process, of the plant."""

from operator import add, mul
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from drivers.config import MAX_BUSES
from drivers.family import Family
from drivers.protocol import BUS, Frame
from drivers.signals import LEGS
from drivers.tick_columns import SENSORS
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
    """The encoder slips: its reading is the length plus a constant, `by_m`."""

    by_m: float


class EncoderFreeze(LegFault, kind="encoder_freeze", effect=("frozen", last, True)):
    """The encoder's reading stays as it was when the fault began, with rate zero."""


class EncoderDrift(LegFault, kind="encoder_drift", effect=("drifts", None, "by_m_s")):
    """The encoder's reading drifts away from the length at a constant speed, also seen in the rate."""

    by_m_s: float


class EncoderNoise(LegFault, kind="encoder_noise", effect=("noise", None, "sigma_m")):
    """White noise on the leg length in the feedback, with standard deviation `sigma_m`."""

    sigma_m: Annotated[float, Field(ge=0)]
    """Standard deviation of the length."""
    seed: Annotated[int, Field(ge=0)] = 0


class EncoderLate(LegFault, kind="encoder_late", effect=("late_ns", later, "by_ms")):
    """The feedback is late by `by_ms`; for that time length and rate stay as when the fault began."""

    by_ms: Annotated[float, Field(gt=0, le=1000)] = 1.0


class EncoderScale(LegFault, kind="encoder_scale", effect=("scales", None, "factor")):
    """The encoder multiplies the motion since the fault began, and the rate, by a factor."""

    factor: float


class EncoderSign(LegFault, kind="encoder_sign", effect=("scales", None, -1.0)):
    """The encoder counts backwards from its reading when the fault begins."""


class EncoderLost(LegFault, kind="encoder_lost", effect=("lost", last, True)):
    """The drive detects that its encoder is lost: it reports this, and still executes commands."""


def _known_sensor(name: str) -> str:
    if name not in SENSORS:
        raise ValueError(f"unknown sensor, allowed: {', '.join(SENSORS)}, given: {name}")
    return name


class SensorFault(LastingFault):
    """A fault of one sensor next to the drives; second encoders and load cells are those of one leg."""

    sensor: Annotated[str, AfterValidator(_known_sensor)]
    """The sensor: `tracker`, `length_0` (second encoder of leg 0), ..."""
    axis: Annotated[int, Field(ge=0, lt=6)] = 0
    """Index of the quantity that is wrong, in the order of the sensor's column."""

    def act(self, present: Present) -> None:
        """Add this fault to those of the sensors."""
        present.sensors.append(present.own)


class SensorLost(SensorFault, kind="sensor_lost"):
    """The sensor sends nothing."""


class SensorLate(SensorFault, kind="sensor_late"):
    """The sensor's frames are late by `by_ms`."""

    by_ms: Annotated[float, Field(gt=0, le=1000)]


class SensorFrozen(SensorFault, kind="sensor_frozen"):
    """The sensor repeats the sample at the begin of the fault."""


class SensorOffset(SensorFault, kind="sensor_offset"):
    """The sensor's quantity `axis` is off by a constant, `by`, SI units (angles of a tracker: rad)."""

    by: float


class SensorDrift(SensorFault, kind="sensor_drift"):
    """The sensor's quantity `axis` drifts by `by` SI units per second."""

    by: float


class SensorOutlier(SensorFault, kind="sensor_outlier"):
    """A share of the sensor's samples, `percent`, is off by `by` SI units in quantity `axis`."""

    by: float
    percent: Annotated[float, Field(gt=0, le=100)] = 1.0


class DriveSilence(LegFault, kind="drive_silence", effect=("silent", last, True)):
    """The drive sends no frames, but still receives commands."""


class DriveReset(Fault, kind="drive_reset", effect=("reset", last, True)):
    """The drive restarts at this instant: it is in BOOT, its brake closes, its set-up is lost."""

    leg: Annotated[int, Field(ge=0, lt=LEGS)]


class DriveGain(LegFault, kind="drive_gain", effect=("gain", mul, "factor")):
    """The leg's force is the drive's force times `factor`."""

    factor: float


class DriveSign(LegFault, kind="drive_sign", effect=("gain", mul, -1.0)):
    """The leg's force has the wrong sign, as with swapped wires."""


class DriveSaturation(LegFault, kind="drive_saturation", effect=("saturation_N", min, "limit_N")):
    """The drive's force is limited to `limit_N`."""

    limit_N: Annotated[float, Field(ge=0)]


class BrakeStuckOpen(LegFault, kind="brake_stuck_open", effect=("stuck", last, False)):
    """The brake stays released, whatever the drive commands."""


class BrakeStuckClosed(LegFault, kind="brake_stuck_closed", effect=("stuck", last, True)):
    """The brake stays engaged, whatever the drive commands."""


class BrakeSlow(LegFault, kind="brake_slow", effect=("slow_ns", later, "by_ms")):
    """The brake opens and closes later than its drive assumes, by `by_ms`."""

    by_ms: Annotated[float, Field(gt=0, le=10_000)]


class BrakeSlipping(LegFault, kind="brake_slipping", effect=("share", mul, "share")):
    """The engaged brake holds only a share of its force, `share`."""

    share: Annotated[float, Field(ge=0, le=1)]


BRAKES = (BrakeStuckOpen, BrakeStuckClosed, BrakeSlipping)
"""Faults of the plant's brakes."""


class FramesLoss(FrameFault, kind="frames_loss"):
    """Frames are lost: an affected frame never arrives."""

    copies: ClassVar[int] = 0


class FramesDuplicate(FrameFault, kind="frames_duplicate"):
    """Frames are duplicated: an affected frame arrives twice."""

    copies: ClassVar[int] = 2


class FramesDelay(FrameFault, kind="frames_delay"):
    """Frames are delayed: an affected frame arrives `by_ms` later."""

    by_ms: Annotated[float, Field(gt=0, le=1000)]

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Arrival of an affected frame, `by_ms` after its time."""
        return super().strike(t_ns + round(self.by_ms * 1e6), frame, generator)


class FramesReorder(FrameFault, kind="frames_reorder"):
    """Frames change order: an affected frame arrives after the next one of its identifier on its bus."""

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Hold an affected frame back until the next one of its identifier and bus has arrived."""
        held = own.frames.pop(place, [])
        if not held and own.generator.random() < self.probability:
            own.frames[place] = [frame]
            return []
        return [(t_ns, each) for each in (frame, *held)]


class FramesCorrupt(FrameFault, kind="frames_corrupt"):
    """One bit of the data is flipped without an error of the CAN checksum, as by a faulty gateway."""

    def strike(self, t_ns: int, frame: Frame, generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Flip one random bit; a frame without data is unchanged."""
        if not frame.data:
            return [(t_ns, frame)]
        bit = int(generator.integers(8 * len(frame.data)))
        data = bytearray(frame.data)
        data[bit // 8] ^= 1 << bit % 8
        return [(t_ns, frame._replace(data=bytes(data)))]


class FramesForgedCommand(LastingFault, kind="frames_forged_command"):
    """An extra node sends a command after every SYNC: RUN, with `force_N` for each leg and valid checksums.

    Both ends receive it, before the controller's command.
    """

    force_N: float = 0.0


class FramesForgedFeedback(LegFault, kind="frames_forged_feedback", effect=("forged_m", last, "by_m")):
    """A second node with the leg's number answers every SYNC: a length off by `by_m`, valid checksums."""

    by_m: float


class FramesOld(FrameFault, kind="frames_old"):
    """An extra node repeats, after a frame, an older one of its identifier and bus; both ends receive it."""

    adds: ClassVar[bool] = True
    back: Annotated[int, Field(ge=1, le=1000)] = 2
    """Age of the repeated frame, in frames of this identifier on its bus."""

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Store the frame; with the configured probability add an older one after it."""
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
    """Index of the bus in `bus.channels`, from 0; default: every bus."""

    def act(self, present: Present) -> None:
        """Mark the configured bus, or all buses, as off."""
        present.bus_off |= EVERY_BUS if self.bus is None else 1 << self.bus

    def carry(self, _t_ns: int, _frame: Frame, _place: Place, _own: Occurrence) -> list[tuple[int, Frame]]:
        """No arrivals: the frame is lost."""
        return []


class SenderFault(LastingFault):
    """An extra node that sends frames at its own rate; controller and drives receive them."""

    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 1000.0
    bus: BusIndex = 0
    """Index of the node's bus in `bus.channels`, from 0."""

    def frames(self, protocol: Family, number: int) -> tuple[Frame, ...]:
        """Frames that the extra node sends as its transmission `number`, counted from 0."""
        raise NotImplementedError


class BusFlood(SenderFault, kind="bus_flood"):
    """An extra node floods the bus with 8-byte frames that win arbitration against all others."""

    rate_Hz: Annotated[float, Field(gt=0, le=100_000)] = 8000.0
    identifier: Annotated[int, Field(ge=0, le=0x7FF)] = 0

    def frames(self, _protocol: Family, _number: int) -> tuple[Frame, ...]:
        """One frame of 8 bytes with the configured identifier, per transmission."""
        return (Frame(self.identifier, _DATA, BUS * self.bus),)


class BusSecondController(SenderFault, kind="bus_second_controller"):
    """A second controller sends SYNC and a RUN command with `force_N` for each leg."""

    force_N: float = 0.0

    def frames(self, protocol: Family, number: int) -> tuple[Frame, ...]:
        """SYNC and command frames of one tick; only the command if it is also the poll."""
        from plant_fmu.faults.foreign_controller import forged  # noqa: PLC0415 - compiled code: not for who only reads a configuration

        frames = forged(protocol, self.force_N, number, sync=True)
        return tuple(frame for frame in frames if frame.bus == self.bus)


class ProcessKill(Fault, kind="process_kill"):
    """The process is killed (SIGKILL): its drives fall silent and its log ends."""


class ProcessStop(Fault, kind="process_stop"):
    """The process is stopped (SIGSTOP) and continued after `for_s`."""

    for_s: Annotated[float, Field(gt=0, le=3600)]
    """Time for which the process is stopped."""


class ProcessSlow(LastingFault, kind="process_slow"):
    """Every iteration of the process's loop takes `by_ms` longer."""

    by_ms: Annotated[float, Field(gt=0, le=1000)]


PROCESS = (ProcessKill, ProcessStop, ProcessSlow)
"""Faults of the operating-system process, which a simulated plant does not have."""


class PlantNaN(LastingFault, kind="plant_nan", effect=("not_finite", last, True)):
    """The plant's leg lengths are NaN."""


class PlantHang(LastingFault, kind="plant_hang", effect=("hangs", last, True)):
    """The plant hangs in a step: no drive answers; afterwards it makes up for the missed time."""


class PlantCrash(Fault, kind="plant_crash", effect=("crashes", last, True)):
    """The plant fails at this instant, and the emulated drives stop with it."""


class WrenchStep(LastingFault, kind="wrench_step"):
    """A constant wrench on the platform at its origin, base frame."""

    force_N: Vector = (0.0, 0.0, 0.0)
    moment_N_m: Vector = (0.0, 0.0, 0.0)

    def act(self, present: Present) -> None:
        """Add this wrench to those of other faults."""
        present.wrench += (*self.force_N, *self.moment_N_m)


class PayloadStep(LastingFault, kind="payload_step"):
    """An extra mass on the platform, simulated as its weight only: it adds no inertia."""

    mass_kg: Annotated[float, Field(gt=0)]
    position_m: Vector = (0.0, 0.0, 0.0)
    """Position of the extra mass, platform frame."""

    def act(self, present: Present) -> None:
        """Add this mass to those of other faults."""
        present.masses.append((self.mass_kg, np.array(self.position_m)))


LOADS = (WrenchStep, PayloadStep)
"""Fault kinds that need a platform."""
