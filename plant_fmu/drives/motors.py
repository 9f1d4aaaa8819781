"""The drives' end of single-motor drives: one record and one compiled end, which every family shares.

A family is a subclass of `MotorDrives`. It gives `obey(d, leg, frame, messages)`, which puts what a frame
tells one drive into MESSAGEs at an address and returns how many they are, plus ALONE where no other drive
looks at it, or FAILED to leave it to `request`; and `encode(d, said, frame)`, which fills in its feedback.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import (
    FAILED,
    Pointed,
    address_of,
    call,
    data_at,
    integers_at,
    pointed,
    record_at,
)
from drivers.frame_array import FRAME
from drivers.frame_pointers import frame_at
from drivers.motor_kernels import EAR
from drivers.protocol import Frame, off_bus
from drivers.signals import INVALID, LEGS, DriveFault, DriveMode, DriveState
from drivers.tick_columns import Record
from drivers.transmission import FIELDS
from plant_fmu.drives import ends

MOST_REGISTERS, MOST_ASKED = 8, 64
"""That a drive remembers; and that one frame asks for."""
ALONE = 1 << 8
SAID = np.dtype(
    [
        *((name, "<i8") for name in ("leg", "runs", "fails", "lost", "fault", "code")),
        *((name, "<f8") for name in ("turns", "speed", "torque")),
    ]
)
"""What one drive reads: turns, turns/s and N m of its motor; whether it runs, is in fault, has lost its
encoder; and its fault, in fault with the family's code."""
DEVICES = np.dtype(
    [
        # the family
        *((name, "<i8") for name in ("obey", "encode", "ear")),
        ("everyone", "<i8"),  # number that addresses all drives; -1: none does
        ("codes", "<i8", (len(DriveFault),)),  # sent for each fault of its own
        ("watchdog_ns", "<i8"),  # as the drives are delivered
        ("reaction", "<i8"),
        ("buses", "<i8"),  # how many
        ("bus_of", "<i8", (LEGS,)),
        ("nodes", "<i8", (LEGS,)),
        *FIELDS,
        # memory
        ("heard", "<i8", (LEGS,)),  # commands so far: none is a repetition
        ("enabled", "<i8", (LEGS,)),
        ("registers", "<f8", (LEGS, MOST_REGISTERS)),  # what they hold, each family's in an order of its own
        ("host", "<i8", (LEGS,)),  # who wants what of each drive, in families where a query says so
        ("asked", "<i8", (LEGS,)),  # how many registers
        ("wanted", "<i8", (LEGS, MOST_ASKED)),
        ("widths", "<i8", (LEGS, MOST_ASKED)),
        ("said", "<f8", (SAID.itemsize // 8,)),  # scratch: an element of SAID
    ]
)
"""Six emulated drives."""
_DEVICES = record(DEVICES)
ear_at = record_at(record(EAR))
_said_at = record_at(record(SAID))
obeying = pointed(_DEVICES, INTEGER, record(FRAME), INTEGER)
encoding = pointed(_DEVICES, record(SAID), record(FRAME))
reporting = pointed(_DEVICES, *[INTEGER] * 7)
"""What compiles a family's functions."""
_FRAME, _MESSAGE = FRAME.itemsize, ends.MESSAGE.itemsize
OFF, READY, RUN, RESET = map(int, DriveMode)
_RUNS, _FAILS = int(DriveState.RUN), int(DriveState.FAULT)


# what a family uses


@helper
def commands(d: Any, leg: int, mode: int, torque: float, messages: int, count: int) -> int:
    """Put a command, torque N m, behind `count` messages; return their number, as all of these do."""
    d.heard[leg] += 1
    d.enabled[leg] = mode == RUN
    force = torque * d.N_per_Nm[leg]
    return ends.put_message(messages, count, leg, ends.COMMAND, mode, d.heard[leg], force)


@helper
def enables(d: Any, leg: int, torque: float, messages: int, count: int) -> int:
    """Enable a drive, by two commands."""
    count = commands(d, leg, READY, torque, messages, count)
    return commands(d, leg, RUN, torque, messages, count)


@helper
def configures(d: Any, leg: int, watchdog_ns: int, messages: int, count: int) -> int:
    """Set a drive up."""
    return ends.put_message(messages, count, leg, ends.CONFIGURE, d.reaction, watchdog_ns, 0.0)


@helper
def rejects(leg: int, messages: int) -> int:
    """Reject a frame."""
    return ends.put_message(messages, 0, leg, ends.REJECTED, 0, 0, 0.0)


@helper
def answers(leg: int, messages: int, count: int) -> int:
    """Let a drive answer."""
    return ends.put_message(messages, count, leg, ends.SYNC, 0, 0, 0.0)


# the end


@pointed(_DEVICES, INTEGER, INTEGER)
def parse(d: Any, frame_address: int, messages: int) -> int:
    """Decode a frame at the drives of its bus, see `DrivesEnd`."""
    frame = frame_at(frame_address)
    identifier = np.int64(frame.id)
    if frame.bus >= d.buses:
        return 0
    ear = ear_at(d.ear)
    if identifier == ear.requests:
        return FAILED
    number, count = identifier >> ear.shift & ear.mask, 0
    for leg in range(LEGS):
        if (number != d.nodes[leg] and number != d.everyone) or frame.bus != d.bus_of[leg]:
            continue
        put = call(d.obey, (address_of(d), leg, frame_address, messages + count * _MESSAGE))
        if put < 0:
            return FAILED
        count += put & ~ALONE
        if put & ALONE:
            break
    return count


@helper
def _read(d: Any, leg: int, reading: Any, said: Any) -> bool:
    state = reading.state[leg] & ~INVALID
    said.leg, said.runs, said.fails, said.fault = leg, state == _RUNS, state == _FAILS, reading.fault[leg]
    said.code = d.codes[said.fault] if said.fails else 0
    said.lost = reading.state[leg] & INVALID != 0
    said.turns, said.speed, said.torque = ends.at_motor(d, leg, reading)
    return bool(np.isfinite(said.turns) and np.isfinite(said.speed) and np.isfinite(said.torque))


@pointed(_DEVICES, INTEGER, INTEGER, INTEGER, INTEGER)
def answer(d: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Fill in what the drives of a SYNC answer, each on its own bus; FAILED for what is no number."""
    sync, reading = ends.message_at(sync_address), ends.reading_at(reading_address)
    at = np.int64(d.said.ctypes.data)
    said, legs, count = _said_at(at), integers_at(senders, LEGS), 0
    for bus in range(d.buses):
        for k in range(sync.count):
            leg = sync.legs[k]
            if d.bus_of[leg] != bus:
                continue
            if not _read(d, leg, reading, said):
                return FAILED
            call(d.encode, (address_of(d), at, into + count * _FRAME))
            legs[count] = leg
            count += 1
    return count


@reporting
def silent(
    _d: Any, _leg: int, _state: int, _fault: int, _watchdog_ns: int, _reaction: int, _due: int, _into: int
) -> int:
    """Report nothing: such drives speak when they are asked."""
    return 0


_MEMORY = ("heard", "enabled", "registers", "host", "asked", "wanted", "widths")


class MotorDrives(ends.DrivesEnd):
    """Six drives. Mutable state: the record."""

    obey: Pointed
    encode: Pointed
    """The family's functions, see above."""
    beat: Pointed = silent
    """`DrivesEnd.report`."""
    everyone = -1
    """The number of all drives; -1: there is none."""
    codes: Mapping[DriveFault, int] = {}
    otherwise = 0
    """What is sent for a fault of the drive's own, and for others."""

    def __init__(self, family: Any) -> None:
        d: Any = np.zeros((), DEVICES)
        super().__init__(d, parse, answer, self.beat)
        self.family = family
        d["obey"], d["encode"] = self.obey.address, self.encode.address
        d["ear"], d["everyone"] = data_at(family.tables), self.everyone
        d["watchdog_ns"], d["reaction"] = round(family.delivered_s * 1e9), family.traits.reactions[0]
        for name in ("nodes", "buses", "bus_of"):
            d[name] = family.tables[name]
        d["codes"] = [self.codes.get(fault, self.otherwise) for fault in DriveFault]
        family.transmission.fill(d)
        self.power_up(d)
        self._new = d.copy()

    def power_up(self, d: Record) -> None:
        """Put what six drives remember that have heard nothing into a record: nothing."""

    def request(self, leg: int | None, frame: Frame) -> None:
        """Do what is not compiled, see `converse`.

        leg: whom the frame is for, None: nobody; the frame is as it is on bus 0.
        """
        raise NotImplementedError

    def say(self, leg: int, frame: Frame) -> None:
        """Let a drive send its own part of a dialogue, on its bus."""
        super().say(leg, self.family.to_leg(leg, frame))

    def converse(self, frame: Frame) -> None:
        """Let the family do what is not compiled."""
        legs: tuple[int, ...] = self.family.addressed(frame)
        self.request(legs[0] if legs else None, off_bus(frame))

    def restart(self, legs: Sequence[int]) -> None:
        """Disable drives that were switched off and on, with nothing written in them."""
        for name in _MEMORY:
            self.record[name][list(legs)] = self._new[name][list(legs)]
