"""Frames of a controller that should not exist, and has received no feedback."""

import numpy as np

from drivers.controller_end import ControllerEnd
from drivers.family import Family
from drivers.frame_array import sent_frames
from drivers.protocol import DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode


def forged(protocol: Family, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Command of an extra controller in a tick: RUN, the same force in each leg.

    It takes all drives for enabled. Raises ProtocolError if the force does not fit.
    """
    end = _unheard(protocol)
    end.presume_running()
    frames = end.give(Command(DriveMode.RUN, np.full(LEGS, force_N)), tick)
    return sent_frames(end.begin(tick) if protocol.traits.command_delay_ticks else frames)


def opened(protocol: Family, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Frames of the start of a tick, and the command; only this in a family whose poll is the command."""
    command = forged(protocol, force_N, tick)
    if protocol.traits.command_delay_ticks:
        return command
    return sent_frames(_unheard(protocol).begin(tick)) + command


def _unheard(protocol: Family) -> ControllerEnd:
    """Create the end of a controller that has received no frames."""
    return protocol.controller_end(DriveSetup(0.01, protocol.traits.reactions[0], 1000.0))
