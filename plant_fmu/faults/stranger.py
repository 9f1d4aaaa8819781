"""What a controller sends that should not be there, and has heard no drive."""

import numpy as np

from drivers.cia402.set_up import Cia402Dialogue
from drivers.cia402.states import State
from drivers.motor_dialogue import MotorDialogue
from drivers.protocol import Dialogue, DriveProtocol, DriveSetup, Frame
from drivers.signals import LEGS, Command, DriveMode, DriveState


def forged(protocol: DriveProtocol, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Return a stranger's command of a tick: RUN, the same force in each leg.

    He takes all drives for enabled. Raises ProtocolError if the force does not fit.
    """
    dialogue = _dialogue(protocol)
    if isinstance(dialogue, Cia402Dialogue):
        dialogue = dialogue._replace(states=(State.ENABLED,) * LEGS)
    elif isinstance(dialogue, MotorDialogue):
        dialogue = dialogue._replace(power=(int(DriveState.RUN),) * LEGS)
    dialogue, frames = protocol.command(dialogue, Command(DriveMode.RUN, np.full(LEGS, force_N)), tick)
    return protocol.begin(dialogue, tick) if protocol.command_delay_ticks else frames


def opened(protocol: DriveProtocol, force_N: float, tick: int) -> tuple[Frame, ...]:
    """Return what starts a tick of a stranger's own, and his command; where the poll is that, it alone."""
    command = forged(protocol, force_N, tick)
    return command if protocol.command_delay_ticks else protocol.begin(_dialogue(protocol), tick) + command


def _dialogue(protocol: DriveProtocol) -> Dialogue:
    """Return that of a controller that has heard nothing."""
    return protocol.start(DriveSetup(0.01, protocol.reactions[0], 1000.0))
