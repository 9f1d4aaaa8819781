"""What can go wrong at the plant's end and on its bus: each kind is a class here and a row of `KINDS`."""

from typing import TYPE_CHECKING, Annotated, Union, get_args

from pydantic import Field

from plant_fmu.faults import frames, kinds
from plant_fmu.faults.fault import Fault

KINDS: tuple[type[Fault], ...] = (
    kinds.EncoderJump,
    kinds.EncoderFreeze,
    kinds.EncoderDrift,
    kinds.EncoderNoise,
    kinds.EncoderLate,
    kinds.EncoderScale,
    kinds.EncoderSign,
    kinds.EncoderLost,
    kinds.DriveSilence,
    kinds.DriveReset,
    kinds.DriveGain,
    kinds.DriveSign,
    kinds.DriveSaturation,
    kinds.BrakeStuckOpen,
    kinds.BrakeStuckClosed,
    kinds.BrakeSlow,
    kinds.BrakeSlipping,
    frames.FramesLoss,
    frames.FramesDuplicate,
    frames.FramesDelay,
    frames.FramesReorder,
    frames.FramesCorrupt,
    frames.FramesForgedCommand,
    frames.FramesForgedFeedback,
    frames.FramesOld,
    frames.BusOff,
    frames.BusFlood,
    frames.BusSecondController,
    kinds.ProcessKill,
    kinds.ProcessStop,
    kinds.ProcessSlow,
    kinds.PlantNaN,
    kinds.PlantHang,
    kinds.PlantCrash,
    kinds.WrenchStep,
    kinds.PayloadStep,
)
"""One row a kind."""

FAULTS: dict[str, type[Fault]] = {get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in KINDS}
"""`kind` of a fault -> its class."""

if TYPE_CHECKING:
    AnyFault = Fault
else:
    AnyFault = Annotated[Union[KINDS], Field(discriminator="kind")]  # noqa: UP007
    """An entry of `plant.faults`."""
