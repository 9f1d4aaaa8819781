"""The object dictionary of an emulated CiA 402 drive, and which writes it refuses with which abort code.

Values are the numbers that they stand for, in one array (len(ENTRIES),) in the order of ENTRIES. PDO
parameters and mapping: CiA 301, 7.5.2. No state, no clock.
"""

from typing import Any, Literal, NamedTuple

import numpy as np

from drivers.arrays import Ints
from drivers.cia402 import objects as o
from drivers.cia402.objects import Key

PDOS = 4
"""RPDOs, and TPDOs."""
MAPPED = 4
"""Objects that a PDO can carry."""
_PDO_BITS = 64
_IDS = 0x7FF
TORQUE_MODES = (4, o.CYCLIC_TORQUE)
"""Profile torque and cyclic synchronous torque; in both the drive follows the target torque."""
_EVENTS = {254, o.AT_ONCE}
Access = Literal["ro", "rw"]


class Entry(NamedTuple):
    """One object."""

    size: int
    """Bytes."""
    access: Access = "ro"
    default: int = 0
    signed: bool = False
    mappable: str = ""
    """Letters: t into a TPDO, r into an RPDO."""
    allowed: frozenset[int] | None = None
    """Raw values that can be written; None: all."""


def _communication() -> dict[Key, Entry]:
    found: dict[Key, Entry] = {}
    for n in range(PDOS):
        first = n == 0
        for index, types in ((o.RPDO, _EVENTS), (o.TPDO, {o.AT_EVERY_SYNC, *_EVENTS})):
            found[index + n, 0] = Entry(1, default=2)
            found[index + n, 1] = Entry(4, "rw", 0 if first else o.NOT_VALID)
            found[index + n, 2] = Entry(1, "rw", o.AT_ONCE, allowed=frozenset(types))
        for index, key in ((o.RPDO_MAP, o.CONTROLWORD), (o.TPDO_MAP, o.STATUSWORD)):
            found[index + n, 0] = Entry(1, "rw", int(first))
            for k in range(MAPPED):
                found[index + n, k + 1] = Entry(4, "rw", o.mapped(key, 16) if first and k == 0 else 0)
    return found


ENTRIES: dict[Key, Entry] = {
    o.DEVICE_TYPE: Entry(4, default=2 << 16 | o.PROFILE_402),
    o.ERROR_REGISTER: Entry(1),
    (0x1005, 0): Entry(4, default=o.SYNC_ID),
    (0x1014, 0): Entry(4),
    (0x1016, 0): Entry(1, default=1),
    o.CONSUMER_HEARTBEAT: Entry(4, "rw"),
    o.PRODUCER_HEARTBEAT: Entry(2, "rw"),
    (0x1018, 0): Entry(1, default=4),
    (0x1018, 1): Entry(4),
    (0x1018, 2): Entry(4),
    o.REVISION: Entry(4, default=1),
    o.SERIAL: Entry(4),
    (0x1029, 0): Entry(1, default=1),
    o.COMMUNICATION_ERROR: Entry(1, "rw", allowed=frozenset({0, 1})),
    **_communication(),
    o.ABORT_CONNECTION: Entry(2, "rw", 1, signed=True, allowed=frozenset({1})),
    o.ERROR_CODE: Entry(2, mappable="t"),
    o.CONTROLWORD: Entry(2, "rw", mappable="r"),
    o.STATUSWORD: Entry(2, mappable="t"),
    o.QUICK_STOP: Entry(2, "rw", 2, signed=True, allowed=frozenset({0, 2})),
    o.FAULT_REACTION: Entry(2, "rw", 2, signed=True, allowed=frozenset({0, 1, 2})),
    o.MODE: Entry(1, "rw", signed=True, mappable="r", allowed=frozenset(TORQUE_MODES)),
    o.MODE_SHOWN: Entry(1, signed=True, mappable="t"),
    o.POSITION: Entry(4, signed=True, mappable="t"),
    o.VELOCITY: Entry(4, signed=True, mappable="t"),
    o.TARGET_TORQUE: Entry(2, "rw", signed=True, mappable="r"),
    o.MAX_TORQUE: Entry(2, "rw", 1000),
    o.RATED_TORQUE: Entry(4),
    o.TORQUE: Entry(2, signed=True, mappable="t"),
    (0x608F, 0): Entry(1, default=2),
    o.ENCODER_INCREMENTS: Entry(4),
    o.MOTOR_REVOLUTIONS: Entry(4, default=1),
    (0x60C2, 0): Entry(1, default=2),
    o.PERIOD_MANTISSA: Entry(1, "rw", 1),
    o.PERIOD_EXPONENT: Entry(1, "rw", 0xFD, signed=True),
    o.SUPPORTED_MODES: Entry(4, default=o.SUPPORTS_CYCLIC_TORQUE | 1 << 3),
}
"""What the emulated drives have, with what a drive has after power-up."""
PLACE = {key: place for place, key in enumerate(ENTRIES)}
_INDICES = {index for index, _ in ENTRIES}


def defaults(node: int, rated_torque_mNm: int, increments: int, revolutions: int) -> Ints:
    """Return the values of a drive that has just been powered up."""
    own = {
        (0x1014, 0): o.EMCY_ID + node,
        o.SERIAL: node,
        o.RATED_TORQUE: rated_torque_mNm,
        o.ENCODER_INCREMENTS: increments,
        o.MOTOR_REVOLUTIONS: revolutions,
    }
    for n in range(PDOS):
        own |= {(o.RPDO + n, 1): o.RPDO_ID[n] + node | (o.NOT_VALID if n else 0)}
        own |= {(o.TPDO + n, 1): o.TPDO_ID[n] + node | (o.NOT_VALID if n else 0)}
    return np.array([own.get(key, entry.default) for key, entry in ENTRIES.items()], np.int64)


def signed(key: Key, raw: int) -> int:
    """Return a raw value as the number that it stands for."""
    entry = ENTRIES[key]
    bits = 8 * entry.size
    return raw - (1 << bits) if entry.signed and raw >> bits - 1 else raw


def fill_pdos(row: Any) -> None:
    """Put the PDOs that a drive has into its element of DEVICE, from its objects."""
    row["pdos"] = row["counts"] = 0
    for way, (parameters, mapping) in enumerate(((o.RPDO, o.RPDO_MAP), (o.TPDO, o.TPDO_MAP))):
        found = 0
        for n in range(PDOS):
            cob, kind, count = (
                int(row["values"][PLACE[key]])
                for key in ((parameters + n, 1), (parameters + n, 2), (mapping + n, 0))
            )
            if cob & o.NOT_VALID or not count or (way and kind != o.AT_EVERY_SYNC):
                continue
            first = PLACE[mapping + n, 1]
            entries = row["values"][first : first + count].tolist()
            row["pdos"][way, found], row["counts"][way, found] = cob & _IDS, count
            row["sizes"][way, found] = sum(entry & 0xFF for entry in entries) // 8
            row["places"][way, found, :count] = [PLACE[entry >> 16, entry >> 8 & 0xFF] for entry in entries]
            found += 1


def missing(key: Key) -> int:
    """Return the abort code for an object that is not there; 0 for one that is."""
    if key in ENTRIES:
        return 0
    return o.NO_SUB_INDEX if key[0] in _INDICES else o.NO_OBJECT


def refused(values: Ints, key: Key, value: int, size: int) -> int:
    """Return the abort code with which a write is refused; 0: it is taken. size: bytes, 0: not said."""
    entry = ENTRIES[key]
    if entry.access == "ro":
        return o.READ_ONLY
    if size and size != entry.size:
        return o.TOO_LONG if size > entry.size else o.TOO_SHORT
    if entry.allowed is not None and signed(key, value) not in entry.allowed:
        return o.BAD_VALUE
    index, sub = key
    if not o.RPDO <= index < o.TPDO_MAP + PDOS:
        return 0
    if index & 0x0200:  # the mappings lie 0x200 above the parameters
        return _mapping_refused(values, key, value)
    now = int(values[PLACE[index, 1]])
    if sub != 1 or value & o.NOT_VALID:
        return 0
    if not 1 <= value & 0x3FFF_FFFF <= _IDS:
        return o.BAD_VALUE
    return o.BAD_STATE if not now & o.NOT_VALID and now & _IDS != value & _IDS else 0


def _mapping_refused(values: Ints, key: Key, value: int) -> int:
    index, sub = key
    letter = "r" if index < o.TPDO else "t"
    if not values[PLACE[index - 0x200, 1]] & o.NOT_VALID or (sub and values[PLACE[index, 0]]):
        return o.BAD_STATE
    if sub:
        return 0 if _fits(value, letter) else o.CANNOT_MAP
    if value > MAPPED:
        return o.MAPPING_TOO_LONG
    entries = values[PLACE[index, 1] : PLACE[index, 1] + value].tolist()
    if not all(_fits(entry, letter) for entry in entries):
        return o.CANNOT_MAP
    return o.MAPPING_TOO_LONG if sum(entry & 0xFF for entry in entries) > _PDO_BITS else 0


def _fits(entry: int, letter: str) -> bool:
    key = entry >> 16, entry >> 8 & 0xFF
    return key in ENTRIES and letter in ENTRIES[key].mappable and entry & 0xFF == 8 * ENTRIES[key].size
