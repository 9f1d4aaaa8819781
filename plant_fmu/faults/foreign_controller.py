"""Frames of an additional controller that should not be on the bus, and has received no feedback."""

import numpy as np

from drivers.family import Family
from drivers.frame_array import sent_frames
from drivers.protocol import DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode


def forged(protocol: Family, force_N: float, tick: int, *, sync: bool = False) -> tuple[Frame, ...]:
    """Command frames of an extra controller in a tick: RUN, with `force_N` (push positive) for each leg.

    sync: True to add SYNC, unless the command is also the poll. It presumes that all drives are enabled.
    Raises ProtocolError if the force does not fit.
    """
    end = protocol.controller_end(DriveSetup(0.01, protocol.traits.reactions[0], 1000.0))
    polls = protocol.traits.command_delay_ticks > 0
    before = sent_frames(end.begin(tick)) if sync and not polls else ()
    end.presume_running()
    frames = end.give(Command(DriveMode.RUN, np.full(LEGS, force_N)), tick)
    return before + sent_frames(end.begin(tick) if polls else frames)
