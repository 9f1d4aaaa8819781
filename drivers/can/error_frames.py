"""Error frames: what a CAN controller tells of itself and of the bus.

The identifier of an error frame is a set of classes, its eight bytes say more of each: linux/can/error.h.
"""

from enum import IntFlag
from typing import NamedTuple

from drivers.protocol import Frame
from drivers.signals import BusState


class ErrorClass(IntFlag):
    """Classes of error frames, CAN_ERR_* of linux/can/error.h."""

    TX_TIMEOUT = 0x001
    """The driver has given up on a frame."""
    LOST_ARBITRATION = 0x002
    CONTROLLER = 0x004
    """States and overflows, in byte 1."""
    PROTOCOL = 0x008
    """Bit, stuff, form and CRC errors, in bytes 2 and 3."""
    TRANSCEIVER = 0x010
    """Wires open or shorted, in byte 4."""
    ACK = 0x020
    """Nobody has acknowledged a frame."""
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    """Of no single kind; one a frame where the controller reports each."""
    RESTARTED = 0x100
    """The controller is back after bus-off."""
    COUNTERS = 0x200
    """The error counters are in bytes 6 and 7."""


RX_OVERFLOW = 0x01
WARNING, PASSIVE, ACTIVE = 0x04 | 0x08, 0x10 | 0x20, 0x40
"""Bits of byte 1: of reception and of transmission, and the return to error active."""


class ErrorReport(NamedTuple):
    """What one error frame says."""

    classes: ErrorClass
    state: BusState
    """UNKNOWN where the frame says nothing of it."""
    overflow: bool
    """The controller has lost a received frame."""
    counters: tuple[int, int] | None
    """Transmit and receive error counters, where the frame has them."""


def read_error(frame: Frame) -> ErrorReport:
    """Return what an error frame says; of a frame that is too short, what its identifier says."""
    classes = ErrorClass(frame.id & sum(ErrorClass))
    data = frame.data.ljust(8, b"\0")
    detail = data[1] if ErrorClass.CONTROLLER in classes else 0
    if ErrorClass.BUS_OFF in classes:
        state = BusState.OFF
    elif detail & PASSIVE:
        state = BusState.PASSIVE
    elif detail & WARNING:
        state = BusState.WARNING
    elif detail & ACTIVE or ErrorClass.RESTARTED in classes:
        state = BusState.ACTIVE
    else:
        state = BusState.UNKNOWN
    counters = (data[6], data[7]) if ErrorClass.COUNTERS in classes else None
    return ErrorReport(classes, state, bool(detail & RX_OVERFLOW), counters)
