"""Rules on the frames that are heard: those of another controller, and too many that were refused."""

from drivers.compiled.compiler import helper
from drivers.signals import Foreign
from hil.safety.history import ones

OFTEN = 8
"""Ticks with a refused frame of the drives, among those remembered, that make a bus nobody can rely on."""
_CONTROLLER = int(Foreign.SYNC | Foreign.COMMAND | Foreign.CONFIG)
_ESTOP = int(Foreign.ESTOP)


@helper
def second_controller(foreign: int) -> bool:
    """Tell whether somebody else controls the drives: nobody hears his own frames."""
    return bool(foreign & _CONTROLLER)


@helper
def estop_heard(foreign: int) -> bool:
    """Tell whether another node has sent an emergency stop."""
    return bool(foreign & _ESTOP)


@helper
def unreliable(history: int) -> bool:
    """Tell whether frames of the drives were refused in OFTEN of the ticks remembered."""
    return ones(history) >= OFTEN
