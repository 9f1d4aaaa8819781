"""The state machine of CiA 402, mapped to DriveMode and DriveState, and the error codes of EMCY messages.

Statusword and transitions: IEC 61800-7-201, tables of the finite state automaton. The drive operates its
brake: it is open in Operation Enabled and Quick Stop Active only. Codes: CiA 301, table 26; of drives: CiA
402-2 (IEC 61800-7-201), table of error codes. The first two digits give the class, which explains a code
without an entry of its own.
"""

from enum import IntEnum

from drivers.compiled.compiler import helper
from drivers.signals import DriveFault, DriveMode, DriveState


class State(IntEnum):
    """States of the CiA 402 finite state automaton of a drive."""

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
"""State of a drive that has not reported yet."""
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
"""Statusword of the emulated drives (remote, voltage enabled, quick stop as in the state), mask of its state
bits, and DriveState. Switched On gives no force: force acts in Operation Enabled."""
STATUSWORDS = {state: word for state, (word, _, _) in _WORDS.items()}
DRIVE_STATE = tuple(known for _, _, known in _WORDS.values())
"""DriveState by State."""


def _state(low: int) -> int:
    fitting = (state for state, (word, mask, _) in _WORDS.items() if low & mask == word & mask)
    return next(fitting, UNHEARD)


STATE_OF = tuple(map(_state, range(128)))
"""State of the low seven bits of a statusword; UNHEARD for invalid bits."""

DISABLE_VOLTAGE, STOP_QUICKLY, SHUTDOWN, SWITCH_ON, ENABLE, RESET_FAULT = 0x00, 0x02, 0x06, 0x07, 0x0F, 0x80
"""Controlwords."""
_OFF, _READY, _RUN, _RESET = map(int, DriveMode)
NOT_READY, DISABLED, READY_TO_SWITCH_ON, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT_REACTION, IN_FAULT = map(
    int, State
)
"""The states as numbers, for kernels."""


@helper
def controlword(mode: int, state: int, edge: bool, stopped: bool) -> int:
    """Controlword that brings a drive from its state one step towards a mode.

    edge: True if this tick's RESET has bit 7; a fault is cleared at its rising edge. stopped: the drive has
    had a quick stop, and only a RESET enables it. Only a drive that reports Switched On is enabled. OFF goes
    through Ready to Switch On, because Disable Voltage would end a quick stop.
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
    """State (State) that a drive enters from `state` when it receives a controlword.

    rises: bit 7 was 0 before. Transitions 2 to 12, 15 and 3 with 4; 16 belongs to other quick stop options.
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


HEARTBEAT_LOST = 0x8130
CODES = {
    DriveFault.WATCHDOG: HEARTBEAT_LOST,
    DriveFault.OVERFORCE: 0x8311,
    DriveFault.SENSOR: 0x7305,
    DriveFault.STROKE: 0x8612,
}
"""EMCY code of an emulated drive for its fault."""
_MEANINGS = {
    0x2310: "continuous over current",
    0x2320: "short circuit or earth leakage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x5441: "contact of the enable input",
    0x7121: "motor blocked",
    0x7305: "incremental encoder 1 fault",
    0x7310: "speed",
    0x7380: "position sensor",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    HEARTBEAT_LOST: "life guard or heartbeat error: the drive missed the controller's heartbeat",
    0x8140: "recovered from bus off",
    0x8150: "CAN-ID collision",
    0x8210: "PDO not processed because of its length",
    0x8220: "PDO length exceeded",
    0x8250: "RPDO timeout",
    0x8311: "excess torque",
    0x8400: "velocity speed controller",
    0x8500: "position controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "sync controller",
}
_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the device's input side",
    0x22: "current inside the device",
    0x23: "current at the device's output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "temperature of the device",
    0x43: "temperature of the drive",
    0x50: "hardware of the device",
    0x60: "software of the device",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x71: "power",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x83: "torque control",
    0x84: "velocity control",
    0x85: "position control",
    0x86: "positioning",
    0x87: "synchronisation",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "specific to the device: see its manual",
}


def meaning(code: int) -> str:
    """Meaning of an EMCY error code, in words; for a code without an entry that of its class."""
    fitting = _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0, "unknown")
    return _MEANINGS.get(code, fitting)
