"""The object dictionary of an emulated CiA 402 drive, and the abort codes of refused writes.

The objects are those of `emulated_drive.eds`. Values are signed or unsigned numbers in one array
(len(ENTRIES),), in the order of ENTRIES. PDO parameters and mapping: CiA 301, 7.5.2. No state, no clock.
"""

from configparser import ConfigParser
from importlib import resources
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from drivers.arrays import Ints
from drivers.cia402 import objects as o
from drivers.cia402.objects import Key

PDOS = 4
"""Number of RPDOs, and of TPDOs."""
MAPPED = 4
"""Largest number of objects in a PDO."""
_PDO_BITS = 64
_IDS = 0x7FF
TORQUE_MODES = (4, o.CYCLIC_TORQUE)
"""Profile torque and cyclic synchronous torque; in both modes the drive follows the target torque."""
_EVENTS = {254, o.AT_ONCE}
_ALLOWED: dict[Key, set[int]] = {
    o.COMMUNICATION_ERROR: {0, 1},
    o.ABORT_CONNECTION: {1},
    o.QUICK_STOP: {0, 2},
    o.FAULT_REACTION: {0, 1, 2},
    o.MODE: {*TORQUE_MODES},
    **{(o.RPDO + n, 2): _EVENTS for n in range(PDOS)},
    **{(o.TPDO + n, 2): {o.AT_EVERY_SYNC, *_EVENTS} for n in range(PDOS)},
}
"""Object -> values that can be written, for objects that do not accept every value."""
_SIGNED, _SIZES = range(2, 5), {2: 1, 3: 2, 4: 4, 5: 1, 6: 2, 7: 4}
"""Data types of the EDS: the signed ones, and the number of bytes of each."""


class Entry(NamedTuple):
    """One object of the object dictionary."""

    size: int
    """Number of bytes."""
    signed: bool
    writable: bool
    default: int
    mappable: str
    """t: mappable into a TPDO, r: into an RPDO, empty: not mappable."""


def _entries() -> dict[Key, Entry]:
    sheet, found = ConfigParser(), {}
    text = resources.files("drivers.cia402").joinpath("emulated_drive.eds").read_text("ascii")
    assert crc32(text.encode()) == 0xC3690F82, (
        "the EDS has changed: state its CRC-32, part of the kernels' cache key"
    )
    sheet.read_string(text)
    for name in sheet.sections():
        of, (index, _, sub) = sheet[name], name.partition("sub")
        if "DataType" in of:
            kind, writable = int(of["DataType"], 16), of["AccessType"] == "rw"
            letter = ("r" if writable else "t") if of.getboolean("PDOMapping") else ""
            entry = Entry(_SIZES[kind], kind in _SIGNED, writable, int(of["DefaultValue"]), letter)
            found[int(index, 16), int(sub or "0", 16)] = entry
    return found


ENTRIES = _entries()
"""Objects of the emulated drives, with their values at power-up."""
PLACE = {key: place for place, key in enumerate(ENTRIES)}
_INDICES = {index for index, _ in ENTRIES}


def defaults(node: int, rated_torque_mNm: int, increments: int) -> Ints:
    """Values (len(ENTRIES),) of all objects of a drive at power-up."""
    own = {
        (0x1014, 0): o.EMCY_ID + node,
        o.SERIAL: node,
        o.RATED_TORQUE: rated_torque_mNm,
        o.ENCODER_INCREMENTS: increments,
    }
    for n in range(PDOS):
        own |= {(o.RPDO + n, 1): o.RPDO_ID[n] + node | (o.NOT_VALID if n else 0)}
        own |= {(o.TPDO + n, 1): o.TPDO_ID[n] + node | (o.NOT_VALID if n else 0)}
    return np.array([own.get(key, entry.default) for key, entry in ENTRIES.items()], np.int64)


def signed(key: Key, raw: int) -> int:
    """Integer value of an object's raw bits: signed if the object's data type is signed."""
    entry = ENTRIES[key]
    bits = 8 * entry.size
    return raw - (1 << bits) if entry.signed and raw >> bits - 1 else raw


def fill_pdos(row: Any) -> None:
    """Derive the active PDOs from a drive's objects. Changes the DEVICE record."""
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
    """SDO abort code for access to an object that does not exist; 0 if it exists."""
    if key in ENTRIES:
        return 0
    return o.NO_SUB_INDEX if key[0] in _INDICES else o.NO_OBJECT


def refused(values: Ints, key: Key, value: int, size: int) -> int:
    """SDO abort code of a write, 0 if it is allowed; size: bytes, 0 if the request does not state it."""
    entry = ENTRIES[key]
    if not entry.writable:
        return o.READ_ONLY
    if size and size != entry.size:
        return o.TOO_LONG if size > entry.size else o.TOO_SHORT
    if key in _ALLOWED and signed(key, value) not in _ALLOWED[key]:
        return o.BAD_VALUE
    index, sub = key
    if not o.RPDO <= index < o.TPDO_MAP + PDOS:
        return 0
    if index & 0x0200:  # indices of mappings: 0x200 above those of parameters
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
