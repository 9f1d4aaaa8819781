"""What a bus has received, for people to compare."""

from drivers.arrays import Rows
from drivers.frame_array import received_frames
from drivers.protocol import Received


def got(frames: Rows) -> list[Received]:
    """Return elements of FRAME as received frames."""
    return [*received_frames(frames)]
