"""Objects of CiA 301 and CiA 402 that a run uses, and the expedited SDO frames that read and write them.

Identifiers and services: CiA 301 (EN 50325-4), 7.2 and 7.3. Drive objects: CiA 402-2 (IEC 61800-7-201).
Integers are little-endian. No state, no clock.
"""

NMT_ID, SYNC_ID, EMCY_ID = 0x000, 0x080, 0x080
TPDO_ID = 0x180, 0x280, 0x380, 0x480
RPDO_ID = 0x200, 0x300, 0x400, 0x500
SDO_REPLY_ID, SDO_REQUEST_ID, HEARTBEAT_ID = 0x580, 0x600, 0x700
"""Predefined connection set; the node number is added, except for NMT and SYNC."""
START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
"""NMT commands."""
BOOTS, STOPPED, OPERATES, PREPARES = 0, 4, 5, 127
"""NMT states in a heartbeat: initialising (its boot-up), stopped, operational, pre-operational."""
UPLOAD = 0x40
"""First byte of an SDO request that reads."""
NOT_VALID = 1 << 31
"""Bit of a PDO's COB-ID: the PDO does not exist."""
AT_EVERY_SYNC, AT_ONCE = 1, 255
"""Transmission types of a PDO."""
CYCLIC_TORQUE = 10
"""Mode of operation: cyclic synchronous torque."""
SUPPORTS_CYCLIC_TORQUE = 1 << 9
"""Bit of `SUPPORTED_MODES`."""
PROFILE_402 = 0x0192
"""Low word of the device type."""

Key = tuple[int, int]
"""Index and sub-index."""
NAMES: dict[Key, str] = {}
"""Objects that messages describe in words."""


def _object(index: int, sub: int, name: str) -> Key:
    NAMES[index, sub] = name
    return index, sub


DEVICE_TYPE = _object(0x1000, 0, "device type")
ERROR_REGISTER: Key = 0x1001, 0
CONSUMER_HEARTBEAT = _object(0x1016, 1, "consumer heartbeat time")
PRODUCER_HEARTBEAT = _object(0x1017, 0, "producer heartbeat time")
REVISION = _object(0x1018, 3, "revision number")
SERIAL = _object(0x1018, 4, "serial number")
COMMUNICATION_ERROR = _object(0x1029, 1, "reaction to a communication error")
ABORT_CONNECTION = _object(0x6007, 0, "abort connection option code")
ERROR_CODE: Key = 0x603F, 0
CONTROLWORD: Key = 0x6040, 0
STATUSWORD: Key = 0x6041, 0
QUICK_STOP = _object(0x605A, 0, "quick stop option code")
FAULT_REACTION = _object(0x605E, 0, "fault reaction option code")
MODE = _object(0x6060, 0, "mode of operation")
MODE_SHOWN = _object(0x6061, 0, "mode of operation display")
POSITION: Key = 0x6064, 0
VELOCITY: Key = 0x606C, 0
TARGET_TORQUE: Key = 0x6071, 0
MAX_TORQUE = _object(0x6072, 0, "max torque")
RATED_TORQUE = _object(0x6076, 0, "motor rated torque")
TORQUE: Key = 0x6077, 0
ENCODER_INCREMENTS = _object(0x608F, 1, "encoder increments")
MOTOR_REVOLUTIONS = _object(0x608F, 2, "motor revolutions")
PERIOD_MANTISSA = _object(0x60C2, 1, "interpolation time period")
PERIOD_EXPONENT = _object(0x60C2, 2, "interpolation time index")
SUPPORTED_MODES = _object(0x6502, 0, "supported drive modes")
RPDO, RPDO_MAP, TPDO, TPDO_MAP = 0x1400, 0x1600, 0x1800, 0x1A00
"""Indices of the first PDO's parameters and mapping."""

HAS = {"has_rated_torque": RATED_TORQUE, "has_abort_connection": ABORT_CONNECTION}
"""Option -> object that drives may lack; a user who sets one to false answers for its effect."""

NO_OBJECT, NO_SUB_INDEX = 0x0602_0000, 0x0609_0011
BAD_COMMAND, READ_ONLY, WRITE_ONLY = 0x0504_0001, 0x0601_0002, 0x0601_0001
CANNOT_MAP, MAPPING_TOO_LONG = 0x0604_0041, 0x0604_0042
TOO_LONG, TOO_SHORT = 0x0607_0012, 0x0607_0013
BAD_VALUE, BAD_STATE = 0x0609_0030, 0x0800_0022
ABORTS: dict[int, str] = {
    0x0503_0000: "toggle bit not alternated",
    0x0504_0000: "SDO protocol timed out",
    BAD_COMMAND: "command specifier not valid or unknown",
    0x0504_0005: "out of memory",
    0x0601_0000: "unsupported access to an object",
    WRITE_ONLY: "attempt to read a write only object",
    READ_ONLY: "attempt to write a read only object",
    NO_OBJECT: "object does not exist in the object dictionary",
    CANNOT_MAP: "object cannot be mapped to the PDO",
    MAPPING_TOO_LONG: "number and length of the objects to be mapped would exceed the PDO length",
    0x0604_0043: "general parameter incompatibility",
    0x0604_0047: "general internal incompatibility in the device",
    0x0606_0000: "access failed due to a hardware error",
    0x0607_0010: "data type or length of the service parameter does not match",
    TOO_LONG: "length of the service parameter too high",
    TOO_SHORT: "length of the service parameter too low",
    NO_SUB_INDEX: "sub-index does not exist",
    BAD_VALUE: "invalid value for the parameter",
    0x0609_0031: "value of the parameter too high",
    0x0609_0032: "value of the parameter too low",
    0x0800_0000: "general error",
    0x0800_0020: "data cannot be transferred or stored",
    0x0800_0021: "data cannot be transferred or stored because of local control",
    BAD_STATE: "data cannot be transferred or stored because of the present device state",
}
"""Abort codes of CiA 301, table 22, in its words."""


def place(key: Key) -> str:
    """Index and sub-index of an object as text, with its name if known: `0x6060:0 mode of operation`."""
    text = f"0x{key[0]:04X}:{key[1]}"
    return f"{text} {NAMES[key]}" if key in NAMES else text


def way_out(key: Key) -> str:
    """Advice for an object that a drive lacks: the option that skips its check, if there is one."""
    options = [name for name, needed in HAS.items() if needed == key]
    return f" (to run without this object: drives.options.{options[0]}: false)" if options else ""


def head(specifier: int, key: Key) -> bytes:
    """First four bytes of an SDO frame: command specifier, index and sub-index."""
    return bytes((specifier, key[0] & 0xFF, key[0] >> 8, key[1]))


def download(key: Key, value: int, size: int) -> bytes:
    """SDO request that writes an object of 1, 2 or 4 bytes; a negative value as two's complement."""
    number = value & ((1 << 8 * size) - 1)
    return head(0x23 | 4 - size << 2, key) + number.to_bytes(4, "little")


def upload(key: Key) -> bytes:
    """SDO request that reads an object."""
    return head(UPLOAD, key) + bytes(4)


def abort(key: Key, code: int) -> bytes:
    """SDO frame that aborts a transfer with a code of CiA 301."""
    return head(0x80, key) + code.to_bytes(4, "little")


def read_value(data: bytes) -> tuple[Key, int] | None:
    """((index, sub-index), unsigned value) in an SDO answer to a read; None for any other data."""
    specifier = data[0] if len(data) == 8 else 0
    if specifier >> 5 != 2 or not specifier & 2:
        return None
    unused = specifier >> 2 & 3 if specifier & 1 else 0
    return (data[1] | data[2] << 8, data[3]), int.from_bytes(data[4 : 8 - unused], "little")


def mapped(key: Key, bits: int) -> int:
    """Entry of a PDO mapping: index, sub-index and length in bits, as 32 bits."""
    return key[0] << 16 | key[1] << 8 | bits
