"""The object dictionary of an emulated CiA 402 drive, and which writes it refuses with which abort code.

Values are unsigned raw numbers in one tuple, in the order of ENTRIES. PDO parameters and mapping: CiA 301,
7.5.2. No state, no clock.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

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
    (0x1001, 0): Entry(1),
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
_PDO_VALUES = slice(PLACE[o.RPDO, 0], PLACE[o.ABORT_CONNECTION])
"""Where the parameters and mappings of all PDOs stand."""
_INDICES = {index for index, _ in ENTRIES}

Values = tuple[int, ...]
"""Raw values, in the order of ENTRIES."""


class Pdo(NamedTuple):
    """A PDO that exists."""

    id: int
    transmission: int
    keys: tuple[Key, ...]
    size: int
    """Bytes."""


def defaults(node: int, rated_torque_mNm: int, increments: int, revolutions: int) -> Values:
    """Return the dictionary of a drive that has just been powered up."""
    own = {
        (0x1014, 0): o.EMCY_ID + node,
        o.SERIAL: node,
        (o.RPDO, 1): o.RPDO_ID[0] + node,
        (o.TPDO, 1): o.TPDO_ID[0] + node,
        o.RATED_TORQUE: rated_torque_mNm,
        o.ENCODER_INCREMENTS: increments,
        o.MOTOR_REVOLUTIONS: revolutions,
    }
    for n in range(1, PDOS):
        own |= {(o.RPDO + n, 1): o.NOT_VALID | o.RPDO_ID[n] + node}
        own |= {(o.TPDO + n, 1): o.NOT_VALID | o.TPDO_ID[n] + node}
    return tuple(own.get(key, entry.default) for key, entry in ENTRIES.items())


def with_value(values: Values, key: Key, value: int) -> Values:
    """Return the dictionary with another value."""
    at = PLACE[key]
    return (*values[:at], value, *values[at + 1 :])


def signed(key: Key, raw: int) -> int:
    """Return a raw value as the number that it stands for."""
    entry = ENTRIES[key]
    bits = 8 * entry.size
    return raw - (1 << bits) if entry.signed and raw >> bits - 1 else raw


def pdos(values: Values, parameters: int, mapping: int) -> tuple[Pdo, ...]:
    """Return the PDOs that exist: RPDO and RPDO_MAP, or TPDO and TPDO_MAP."""
    return _pdos(values[_PDO_VALUES], parameters, mapping)


@lru_cache(maxsize=256)
def _pdos(values: Values, parameters: int, mapping: int) -> tuple[Pdo, ...]:
    def value(index: int, sub: int) -> int:
        return values[PLACE[index, sub] - _PDO_VALUES.start]

    found = []
    for n in range(PDOS):
        cob, count = value(parameters + n, 1), value(mapping + n, 0)
        if cob & o.NOT_VALID or not count:
            continue
        entries = [value(mapping + n, k + 1) for k in range(count)]
        keys = tuple((entry >> 16, entry >> 8 & 0xFF) for entry in entries)
        size = sum(ENTRIES[key].size for key in keys)
        found.append(Pdo(cob & _IDS, value(parameters + n, 2), keys, size))
    return tuple(found)


def missing(key: Key) -> int:
    """Return the abort code for an object that is not there; 0 for one that is."""
    if key in ENTRIES:
        return 0
    return o.NO_SUB_INDEX if key[0] in _INDICES else o.NO_OBJECT


def refused(values: Values, key: Key, value: int, size: int) -> int:
    """Return the abort code with which a write is refused; 0: it is taken. size: bytes, 0: not said."""
    code = missing(key)
    if code:
        return code
    entry = ENTRIES[key]
    if entry.access == "ro":
        return o.READ_ONLY
    if size and size != entry.size:
        return o.TOO_LONG if size > entry.size else o.TOO_SHORT
    number = signed(key, value)
    if entry.allowed is not None and number not in entry.allowed:
        return o.BAD_VALUE
    return _pdo_refused(values, key, value) if o.RPDO <= key[0] < o.TPDO_MAP + PDOS else 0


def _pdo_refused(values: Values, key: Key, value: int) -> int:
    index, sub = key
    if index & 0x0200:  # the mappings lie 0x200 above the parameters
        return _mapping_refused(values, key, value)
    now = values[PLACE[index, 1]]
    if sub == 1:
        if not value & o.NOT_VALID and not 1 <= value & 0x3FFF_FFFF <= _IDS:
            return o.BAD_VALUE
        both = not now & o.NOT_VALID and not value & o.NOT_VALID
        return o.BAD_STATE if both and now & _IDS != value & _IDS else 0
    return 0


def _mapping_refused(values: Values, key: Key, value: int) -> int:
    index, sub = key
    letter = "r" if index < o.TPDO else "t"
    if not values[PLACE[index - 0x200, 1]] & o.NOT_VALID:
        return o.BAD_STATE
    if sub:
        if values[PLACE[index, 0]]:
            return o.BAD_STATE
        return 0 if _fits(value, letter) else o.CANNOT_MAP
    if value > MAPPED:
        return o.MAPPING_TOO_LONG
    entries = [values[PLACE[index, k + 1]] for k in range(value)]
    if not all(_fits(entry, letter) for entry in entries):
        return o.CANNOT_MAP
    return o.MAPPING_TOO_LONG if sum(entry & 0xFF for entry in entries) > _PDO_BITS else 0


def _fits(entry: int, letter: str) -> bool:
    key = entry >> 16, entry >> 8 & 0xFF
    return key in ENTRIES and letter in ENTRIES[key].mappable and entry & 0xFF == 8 * ENTRIES[key].size
