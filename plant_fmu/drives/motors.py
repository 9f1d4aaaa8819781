"""The drives' end of single-motor drives: one record and one set of kernels, which all families share.

A family is a subclass of `MotorDrives` with two compiled functions:

- ``obey(d, leg, frame, messages)`` puts the content of a frame for one drive into MESSAGEs at an address.
  Returns their number, plus ALONE if the frame is for this drive only, or FAILED to leave it to `request`;
- ``encode(d, said, frame)`` fills in the feedback of one drive. Returns the number of further frames, which
  follow in memory.
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
from plant_fmu.drives import codec

MOST_REGISTERS, MOST_ASKED = 8, 64
"""Largest number of registers of a drive, and of registers requested in one frame."""
ALONE = 1 << 8
SAID = np.dtype(
    [
        *((name, "<i8") for name in ("leg", "runs", "fails", "lost", "fault", "code")),
        *((name, "<f8") for name in ("turns", "speed", "torque")),
    ]
)
"""Reading of one drive: turns, turns/s and N m of its motor; flags: running, in fault, encoder lost; its
fault, and while it is in fault the family's code of the fault."""
DEVICES = np.dtype(
    [
        # the family; everyone: number that addresses all drives, -1: none; the watchdog time as at delivery
        *(
            (name, "<i8")
            for name in ("obey", "encode", "ear", "everyone", "watchdog_ns", "reaction", "buses")
        ),
        ("codes", "<i8", (len(DriveFault),)),  # code sent per fault
        *((name, "<i8", (LEGS,)) for name in ("bus_of", "nodes")),
        *FIELDS,
        # memory; heard: number of commands so far; host, asked: sender and size of the last query
        *((name, "<i8", (LEGS,)) for name in ("heard", "enabled", "host", "asked")),
        ("registers", "<f8", (LEGS, MOST_REGISTERS)),  # their values, in the order of the family
        *((name, "<i8", (LEGS, MOST_ASKED)) for name in ("wanted", "widths")),
        ("said", "<f8", (SAID.itemsize // 8,)),  # scratch: an element of SAID
    ]
)
"""State of six emulated single-motor drives."""
_DEVICES = record(DEVICES)
ear_at = record_at(record(EAR))
_said_at = record_at(record(SAID))
obeying = pointed(_DEVICES, INTEGER, record(FRAME), INTEGER)
encoding = pointed(_DEVICES, record(SAID), record(FRAME))
reporting = pointed(_DEVICES, *[INTEGER] * 7)
"""Decorators that compile the functions of a family."""
_FRAME, _MESSAGE = FRAME.itemsize, codec.MESSAGE.itemsize
OFF, READY, RUN, RESET = map(int, DriveMode)
_RUNS, _FAILS = int(DriveState.RUN), int(DriveState.FAULT)


# functions for the families


@helper
def commands(d: Any, leg: int, mode: int, torque: float, messages: int, count: int) -> int:
    """Append a command MESSAGE: DriveMode and motor torque, N m; returns the new count."""
    d.heard[leg] += 1
    d.enabled[leg] = mode == RUN
    force = torque * d.N_per_Nm[leg]
    return codec.put_message(messages, count, leg, codec.COMMAND, mode, d.heard[leg], force)


@helper
def enables(d: Any, leg: int, torque: float, messages: int, count: int) -> int:
    """Append two command MESSAGEs, READY and RUN, that enable a drive; returns the new count."""
    count = commands(d, leg, READY, torque, messages, count)
    return commands(d, leg, RUN, torque, messages, count)


@helper
def configures(d: Any, leg: int, watchdog_ns: int, messages: int, count: int) -> int:
    """Append a CONFIGURE MESSAGE with a watchdog time, ns; returns the new count."""
    return codec.put_message(messages, count, leg, codec.CONFIGURE, d.reaction, watchdog_ns, 0.0)


@helper
def rejects(leg: int, messages: int) -> int:
    """Write one MESSAGE that counts the frame as rejected; returns 1."""
    return codec.put_message(messages, 0, leg, codec.REJECTED, 0, 0, 0.0)


@helper
def answers(leg: int, messages: int, count: int) -> int:
    """Append a SYNC MESSAGE, which makes the drive of a leg send its feedback; returns the new count."""
    return codec.put_message(messages, count, leg, codec.SYNC, 0, 0, 0.0)


# the end


@pointed(_DEVICES, INTEGER, INTEGER)
def parse(d: Any, frame_address: int, messages: int) -> int:
    """Decode a frame for the drives on its bus to MESSAGEs; function `parse` of `DrivesEnd`."""
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
    said.turns, said.speed, said.torque = codec.at_motor(d, leg, reading)
    return bool(np.isfinite(said.turns) and np.isfinite(said.speed) and np.isfinite(said.torque))


@pointed(_DEVICES, INTEGER, INTEGER, INTEGER, INTEGER)
def answer(d: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Write the feedback frames for a SYNC message to address `into`; returns how many; FAILED for NaN."""
    sync, reading = codec.message_at(sync_address), codec.reading_at(reading_address)
    at = np.int64(d.said.ctypes.data)
    said, legs, count = _said_at(at), integers_at(senders, LEGS), 0
    for bus in range(d.buses):
        for k in range(sync.count):
            leg = sync.legs[k]
            if d.bus_of[leg] != bus:
                continue
            if not _read(d, leg, reading, said):
                return FAILED
            more = call(d.encode, (address_of(d), at, into + count * _FRAME))
            legs[count : count + 1 + more] = leg
            count += 1 + more
    return count


@reporting
def silent(
    _d: Any, _leg: int, _state: int, _fault: int, _watchdog_ns: int, _reaction: int, _due: int, _into: int
) -> int:
    """Function `report` of drives without a status frame: they send only on request. Returns 0."""
    return 0


_MEMORY = ("heard", "enabled", "registers", "host", "asked", "wanted", "widths")


class MotorDrives(codec.DrivesEnd):
    """The drives' end of six single-motor drives. Mutable state: its record."""

    obey: Pointed
    encode: Pointed
    """Compiled functions of the family, see above."""
    beat: Pointed = silent
    """Function `report` of `DrivesEnd`."""
    everyone = -1
    """Node number that addresses all drives; -1: there is none."""
    codes: Mapping[DriveFault, int] = {}
    otherwise = 0
    """Fault codes that the drives send, and the code of every other fault."""

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
        """Set the power-up state of six drives in the record; by default all is 0."""

    def request(self, leg: int | None, frame: Frame) -> None:
        """Process a frame that the kernels do not decode; called by `converse`.

        leg: addressed leg, None if the frame addresses no leg; the frame has bus index 0.
        """
        raise NotImplementedError

    def say(self, leg: int, frame: Frame) -> None:
        """Append a frame of a start-up dialogue, on the drive's bus."""
        super().say(leg, self.family.to_leg(leg, frame))

    def converse(self, frame: Frame) -> None:
        """Pass a frame that the kernels do not decode to `request`."""
        legs: tuple[int, ...] = self.family.addressed(frame)
        self.request(legs[0] if legs else None, off_bus(frame))

    def restart(self, legs: Sequence[int]) -> None:
        """Restore the power-up state of drives that were switched off and on: disabled, factory registers."""
        for name in _MEMORY:
            self.record[name][list(legs)] = self._new[name][list(legs)]
