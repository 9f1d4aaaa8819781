"""Faults of frames on their way."""

import numpy as np

from drivers.protocol import Frame
from plant_fmu.drives.faults.fault import FrameFault


class FrameLoss(FrameFault):
    """The frame never arrives."""

    def strike(self, frame: Frame, generator: np.random.Generator) -> None:
        """Lose it."""


class FrameCorruption(FrameFault):
    """One bit of the data is flipped behind the back of the bus' own check, as a bad gateway does."""

    def strike(self, frame: Frame, generator: np.random.Generator) -> Frame:
        """Flip one bit of any; an empty frame passes."""
        if not frame.data:
            return frame
        bit = int(generator.integers(8 * len(frame.data)))
        data = bytearray(frame.data)
        data[bit // 8] ^= 1 << bit % 8
        return frame._replace(data=bytes(data))
