"""What can go wrong at the plant's end and on its bus: each kind is a class here and a row of `KINDS`."""

from typing import TYPE_CHECKING, Annotated, Union, get_args

from pydantic import Field

from plant_fmu.faults import brake, bus, drive, encoder, frames, load, plant, process
from plant_fmu.faults.fault import Fault

KINDS: tuple[type[Fault], ...] = (
    encoder.EncoderJump,
    encoder.EncoderFreeze,
    encoder.EncoderDrift,
    encoder.EncoderNoise,
    encoder.EncoderLate,
    encoder.EncoderScale,
    encoder.EncoderSign,
    encoder.EncoderLost,
    drive.DriveSilence,
    drive.DriveReset,
    drive.DriveGain,
    drive.DriveSign,
    drive.DriveSaturation,
    brake.BrakeStuckOpen,
    brake.BrakeStuckClosed,
    brake.BrakeSlow,
    brake.BrakeSlipping,
    frames.FramesLoss,
    frames.FramesDuplicate,
    frames.FramesDelay,
    frames.FramesReorder,
    frames.FramesCorrupt,
    frames.FramesForgedCommand,
    frames.FramesForgedFeedback,
    frames.FramesOld,
    bus.BusOff,
    bus.BusFlood,
    bus.BusSecondController,
    process.ProcessKill,
    process.ProcessStop,
    process.ProcessSlow,
    plant.PlantNaN,
    plant.PlantHang,
    plant.PlantCrash,
    load.WrenchStep,
    load.PayloadStep,
)
"""One row a kind."""

FAULTS: dict[str, type[Fault]] = {get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in KINDS}
"""`kind` of a fault -> its class."""

if TYPE_CHECKING:
    AnyFault = Fault
else:
    AnyFault = Annotated[Union[KINDS], Field(discriminator="kind")]  # noqa: UP007
    """An entry of `plant.faults`."""
