"""Why a word of the operator does not count: one rule for the daemon and the lockstep."""

from drivers.signals import Mode
from hil.loop.cycle import Cycle
from hil.signals import Operator, explain

NOT_LIVE = "the reference takes no set-points: reference.type has to be live"
REFUSED = "operator's command refused: "
"""How the log begins to say so."""


def refusal(command: Operator, mode: Mode, *, was_held: bool, goes_on: bool) -> str:
    """Return why a word without numbers cannot be taken in a mode; empty where it can.

    was_held: the platform was in the tick before, too; goes_on: see `hil.loop.run_end.Course`.
    """
    match command:
        case Operator.ENGAGE if mode is not Mode.IDLE:
            return f"there is nothing to arm in mode {mode.name}: all drives have to be ready (IDLE)"
        case Operator.RELEASE if not (mode is Mode.HELD and was_held):
            return "nothing is held: no platform whose brakes failed"
        case Operator.RESET if mode not in {Mode.FAULT, Mode.WAITING} and not (
            mode is Mode.PARKED and goes_on
        ):
            return f"there is nothing to reset in mode {mode.name}"
        case _:
            return ""


def setpoint_refusals(cycle: Cycle, count: int) -> list[str]:
    """Return why each of the last tick's `count` set-points was refused; empty where it was taken."""
    steering = cycle.parts.steering
    return [NOT_LIVE] * count if steering is None else [explain(each) for each in steering.answers]
