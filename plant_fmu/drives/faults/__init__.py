"""What can go wrong at the plant's end and on its bus: each fault is a class here and a row of `FAULTS`."""

from plant_fmu.drives.faults.encoder import EncoderFreeze, EncoderLost, EncoderOffset
from plant_fmu.drives.faults.fault import Fault
from plant_fmu.drives.faults.frames import FrameCorruption, FrameLoss
from plant_fmu.drives.faults.leg import LegGain, Silence, StuckBrake
from plant_fmu.drives.faults.load import WrenchStep

FAULTS: dict[str, type[Fault]] = {
    "encoder_offset": EncoderOffset,
    "encoder_freeze": EncoderFreeze,
    "encoder_lost": EncoderLost,
    "leg_gain": LegGain,
    "silence": Silence,
    "stuck_brake": StuckBrake,
    "wrench_step": WrenchStep,
    "frame_loss": FrameLoss,
    "frame_corruption": FrameCorruption,
}
"""Every fault by its name."""
