"""The state machine of CiA 402: statusword, controlword, and what they are in the words of the contract.

Statusword and transitions: IEC 61800-7-201, tables of the finite state automaton. The brake is the drive's:
it is open in Operation Enabled and Quick Stop Active alone.

    contract   CiA 402
    BOOT       Not Ready to Switch On
    OFF        Switch On Disabled, Ready to Switch On
    READY      Switched On: no force yet. The force that is asked for acts from Operation Enabled on
    RUN        Operation Enabled
    FAULT      Quick Stop Active, Fault Reaction Active, Fault
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
_LOW: dict[State, tuple[int, int]] = {
    State.NOT_READY: (0x4F, 0x00),
    State.DISABLED: (0x4F, 0x40),
    State.READY_TO_SWITCH_ON: (0x6F, 0x21),
    State.SWITCHED_ON: (0x6F, 0x23),
    State.ENABLED: (0x6F, 0x27),
    State.QUICK_STOP: (0x6F, 0x07),
    State.FAULT_REACTION: (0x4F, 0x0F),
    State.FAULT: (0x4F, 0x08),
}
"""Mask and value of the statusword."""


def _state(word: int) -> int:
    for state, (mask, value) in _LOW.items():
        if word & mask == value:
            return state
    return UNHEARD


STATE_OF = tuple(_state(word) for word in range(128))
"""State of the low seven bits of a statusword; UNHEARD for bits that no state has."""
STATUSWORDS = {
    State.NOT_READY: 0x0200,
    State.DISABLED: 0x0250,
    State.READY_TO_SWITCH_ON: 0x0231,
    State.SWITCHED_ON: 0x0233,
    State.ENABLED: 0x0237,
    State.QUICK_STOP: 0x0217,
    State.FAULT_REACTION: 0x021F,
    State.FAULT: 0x0218,
}
"""Of the emulated drives: remote, voltage enabled, quick stop as the state has it."""

DRIVE_STATE = (
    DriveState.BOOT,
    DriveState.OFF,
    DriveState.OFF,
    DriveState.READY,
    DriveState.RUN,
    DriveState.FAULT,
    DriveState.FAULT,
    DriveState.FAULT,
)
"""The contract's state, by State."""

DISABLE_VOLTAGE, STOP_QUICKLY, SHUTDOWN, SWITCH_ON, ENABLE, RESET_FAULT = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
"""Controlwords."""
_OFF, _READY, _RUN, _RESET = map(int, DriveMode)
_POWERED = int(State.SWITCHED_ON), int(State.ENABLED)
_DISABLED, _READY_TO_SWITCH_ON = int(State.DISABLED), int(State.READY_TO_SWITCH_ON)
_QUICK_STOP, _FAULT, _FAULT_REACTION = int(State.QUICK_STOP), int(State.FAULT), int(State.FAULT_REACTION)
_SWITCHED_ON, _ENABLED = _POWERED
_NOT_READY = int(State.NOT_READY)


@helper
def controlword(mode: int, state: int, edge: bool, stopped: bool) -> int:
    """Return the controlword that brings a drive from its state a step towards a mode.

    edge: whether this tick's RESET has bit 7; a fault is cleared at its rising edge. stopped: the drive has
    been stopped quickly, and is enabled by a RESET alone. Only a drive that reports Switched On is enabled.
    An OFF goes through Ready to Switch On, because Disable Voltage would end a quick stop.
    """
    powered = state in _POWERED
    if mode == _RESET:
        return RESET_FAULT if edge else DISABLE_VOLTAGE
    if mode == _OFF or stopped:
        return SHUTDOWN if powered or state == _QUICK_STOP else DISABLE_VOLTAGE
    if mode == _RUN:
        return ENABLE if powered else DISABLE_VOLTAGE
    if state == _DISABLED:
        return SHUTDOWN
    return SWITCH_ON if powered or state == _READY_TO_SWITCH_ON else DISABLE_VOLTAGE


@helper
def commanded(word: int, state: int, rises: bool) -> int:
    """Return the state to which a controlword brings a drive.

    rises: bit 7 was 0 before. Transitions 2 to 12, 15 and 3 with 4; 16 is that of other quick stop options.
    """
    if state == _FAULT:
        return _DISABLED if rises and word & RESET_FAULT else state
    if state in (_NOT_READY, _FAULT_REACTION) or word & RESET_FAULT:
        return state
    if not word & 0x02:
        return _DISABLED
    if state == _QUICK_STOP:
        return state
    if not word & 0x04:
        return _QUICK_STOP if state == _ENABLED else _DISABLED
    if not word & 0x01:
        return _READY_TO_SWITCH_ON
    if state == _DISABLED:
        return state
    return _ENABLED if word & 0x08 else _SWITCHED_ON
