"""Frames of an additional controller that should not be on the bus, and has received no feedback."""

import numpy as np

from drivers.controller_end import ControllerEnd
from drivers.family import Family
from drivers.frame_array import sent_frames
from drivers.protocol import DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode


def forged(protocol: Family, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Command frames of an extra controller in a tick: RUN, with `force_N` (push positive) for each leg.

    It presumes that all drives are enabled. Raises ProtocolError if the force does not fit.
    """
    end = _unheard(protocol)
    end.presume_running()
    frames = end.give(Command(DriveMode.RUN, np.full(LEGS, force_N)), tick)
    return sent_frames(end.begin(tick) if protocol.traits.command_delay_ticks else frames)


def opened(protocol: Family, force_N: float, tick: int) -> tuple[Frame, ...]:
    """SYNC and command of an extra controller in a tick; only the command if it is also the poll."""
    command = forged(protocol, force_N, tick)
    if protocol.traits.command_delay_ticks:
        return command
    return sent_frames(_unheard(protocol).begin(tick)) + command


def _unheard(protocol: Family) -> ControllerEnd:
    """Controller's end of an extra controller that has received no frames."""
    return protocol.controller_end(DriveSetup(0.01, protocol.traits.reactions[0], 1000.0))
