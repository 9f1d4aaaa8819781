"""The state machine of CiA 402: statusword, controlword, and what they are in the words of the contract.

Statusword and transitions: IEC 61800-7-201, tables of the finite state automaton. The brake is the drive's:
it is open in Operation Enabled and Quick Stop Active alone.
"""

from enum import IntEnum

from drivers.compiled.compiler import helper
from drivers.signals import DriveMode, DriveState


class State(IntEnum):
    """States of the automaton."""

    NOT_READY = 0
    DISABLED = 1
    """Switch On Disabled."""
    READY_TO_SWITCH_ON = 2
    SWITCHED_ON = 3
    ENABLED = 4
    """Operation Enabled."""
    QUICK_STOP = 5
    """Quick Stop Active."""
    FAULT_REACTION = 6
    """Fault Reaction Active."""
    FAULT = 7


UNHEARD = -1
"""State of a drive that has not been heard."""
_WORDS = {
    State.NOT_READY: (0x0200, 0x4F, DriveState.BOOT),
    State.DISABLED: (0x0250, 0x4F, DriveState.OFF),
    State.READY_TO_SWITCH_ON: (0x0231, 0x6F, DriveState.OFF),
    State.SWITCHED_ON: (0x0233, 0x6F, DriveState.READY),
    State.ENABLED: (0x0237, 0x6F, DriveState.RUN),
    State.QUICK_STOP: (0x0217, 0x6F, DriveState.FAULT),
    State.FAULT_REACTION: (0x021F, 0x4F, DriveState.FAULT),
    State.FAULT: (0x0218, 0x4F, DriveState.FAULT),
}
"""Statusword of the emulated drives (remote, voltage enabled, quick stop as the state has it), the bits of it
that are the state, and the contract's state. Switched On gives no force: it acts in Operation Enabled."""
STATUSWORDS = {state: word for state, (word, _, _) in _WORDS.items()}
DRIVE_STATE = tuple(known for _, _, known in _WORDS.values())
"""The contract's state, by State."""


def _state(low: int) -> int:
    fitting = (state for state, (word, mask, _) in _WORDS.items() if low & mask == word & mask)
    return next(fitting, UNHEARD)


STATE_OF = tuple(map(_state, range(128)))
"""State of the low seven bits of a statusword; UNHEARD for bits that no state has."""

DISABLE_VOLTAGE, STOP_QUICKLY, SHUTDOWN, SWITCH_ON, ENABLE, RESET_FAULT = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
"""Controlwords."""
_OFF, _READY, _RUN, _RESET = map(int, DriveMode)
NOT_READY, DISABLED, READY_TO_SWITCH_ON, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT_REACTION, IN_FAULT = map(
    int, State
)
"""The states as numbers, for kernels."""


@helper
def controlword(mode: int, state: int, edge: bool, stopped: bool) -> int:
    """Return the controlword that brings a drive from its state a step towards a mode.

    edge: whether this tick's RESET has bit 7; a fault is cleared at its rising edge. stopped: the drive has
    been stopped quickly, and is enabled by a RESET alone. Only a drive that reports Switched On is enabled.
    An OFF goes through Ready to Switch On, because Disable Voltage would end a quick stop.
    """
    powered = state in (SWITCHED_ON, ENABLED)
    if mode == _RESET:
        return RESET_FAULT if edge else DISABLE_VOLTAGE
    if mode == _OFF or stopped:
        return SHUTDOWN if powered or state == QUICK_STOP else DISABLE_VOLTAGE
    if mode == _RUN:
        return ENABLE if powered else DISABLE_VOLTAGE
    if state == DISABLED:
        return SHUTDOWN
    return SWITCH_ON if powered or state == READY_TO_SWITCH_ON else DISABLE_VOLTAGE


@helper
def commanded(word: int, state: int, rises: bool) -> int:
    """Return the state to which a controlword brings a drive.

    rises: bit 7 was 0 before. Transitions 2 to 12, 15 and 3 with 4; 16 is that of other quick stop options.
    """
    if state == IN_FAULT:
        return DISABLED if rises and word & RESET_FAULT else state
    if state in (NOT_READY, FAULT_REACTION) or word & RESET_FAULT:
        return state
    if not word & 0x02:
        return DISABLED
    if state == QUICK_STOP:
        return state
    if not word & 0x04:
        return QUICK_STOP if state == ENABLED else DISABLED
    if not word & 0x01:
        return READY_TO_SWITCH_ON
    if state == DISABLED:
        return state
    return ENABLED if word & 0x08 else SWITCHED_ON
