"""Check of electronic data sheets (EDS, DCF; CiA 306) of CiA 402 drives before a run.

A sheet is an INI file. Only the sections of the objects that a run uses are read: makers' sheets have errors
elsewhere. No state, no clock.
"""

from collections.abc import Collection, Mapping
from configparser import Error, RawConfigParser
from pathlib import Path

from drivers.cia402 import objects as o
from drivers.cia402.objects import Key, place
from drivers.errors import ConfigurationError

_WRITTEN: tuple[Key, ...] = (
    o.CONSUMER_HEARTBEAT, o.PRODUCER_HEARTBEAT, (o.RPDO, 1), (o.RPDO, 2), (o.RPDO_MAP, 0), (o.TPDO, 1),
    (o.TPDO, 2), (o.TPDO_MAP, 0), o.ABORT_CONNECTION, o.QUICK_STOP, o.FAULT_REACTION, o.MODE, o.MAX_TORQUE,
)  # fmt: skip
_READ: tuple[Key, ...] = (o.DEVICE_TYPE, o.MODE_SHOWN, o.RATED_TORQUE)
_MAPPED: tuple[Key, ...] = (o.CONTROLWORD, o.TARGET_TORQUE, o.STATUSWORD, o.POSITION, o.TORQUE)
_MODES = 16
"""Modes of operation in `SUPPORTED_MODES`; the bits above are the maker's."""
_LONGEST = 500
"""Characters of a parser's message, which quotes the line."""
Sheet = Mapping[str, Mapping[str, str | None]]
"""Entries by section, both names in small letters."""


def check_eds(path: str, *, velocity: bool, may_lack: Collection[Key] = ()) -> None:
    """Check that a drive's data sheet has all objects and PDOs that a run needs.

    velocity: True if 0x606C has to fit into a second TPDO; may_lack: objects that are not required. Raises
    ConfigurationError if the sheet cannot be read, if objects are missing (the message lists all), or if the
    drive has no cyclic synchronous torque mode.
    """
    sheet = _read(path)
    second = ((o.TPDO + 1, 1), (o.TPDO_MAP + 1, 0)) if velocity else ()
    mapped = (*_MAPPED, o.VELOCITY) if velocity else _MAPPED
    lacks = []
    for key in (*_READ, *_WRITTEN, *second, *mapped):
        entry = _entry(sheet, key)
        if entry is None:
            lacks += [] if key in may_lack else [f"{place(key)} is missing{o.way_out(key)}"]
        elif key in (*_WRITTEN, *second) and "w" not in (entry.get("accesstype") or "").lower():
            lacks.append(f"{place(key)} cannot be written")
        elif key in mapped and not _number(entry.get("pdomapping")):
            lacks.append(f"{place(key)} cannot be mapped")
    if lacks:
        raise ConfigurationError(
            f"drives.options.eds: according to {path} the drive lacks objects: {'; '.join(lacks)}"
        )
    supported = _entry(sheet, o.SUPPORTED_MODES) or {}
    modes = _number(supported.get("parametervalue") or supported.get("defaultvalue"))
    if modes and not modes & o.SUPPORTS_CYCLIC_TORQUE:  # 0 and no value say nothing; the drive is asked, too
        named = ", ".join(str(n) for n in range(1, _MODES + 1) if modes >> n - 1 & 1)
        raise ConfigurationError(
            f"drives.options.eds: according to {path} the drive lacks cyclic synchronous torque: "
            f"{place(o.SUPPORTED_MODES)} lists the modes {named}; mode {o.CYCLIC_TORQUE} is needed"
        )


def _read(path: str) -> Sheet:
    if not Path(path).is_file():
        raise ConfigurationError(f"drives.options.eds: no such file: {path}")
    parser = RawConfigParser(strict=False, allow_no_value=True, inline_comment_prefixes=(";",))
    try:
        text = Path(path).read_text("utf-8-sig", "replace")  # names and comments may have another encoding
        parser.read_file(map(str.strip, text.splitlines()), path)
    except (Error, OSError) as error:
        reason = " ".join(str(error).split())[:_LONGEST]
        raise ConfigurationError(f"drives.options.eds: {path} cannot be read: {reason}") from None
    return {name.lower(): parser[name] for name in parser.sections()}


def _entry(sheet: Sheet, key: Key) -> Mapping[str, str | None] | None:
    """Section that describes an object, which elements of a compact array share; None if it is missing."""
    index, sub = key
    whole, own = sheet.get(f"{index:04x}"), sheet.get(f"{index:04x}sub{sub:x}")
    if own is not None or whole is None:
        return own
    elements = _number(whole.get("compactsubobj"))
    return whole if sub <= elements and (elements or not _number(whole.get("subnumber"))) else None


def _number(text: str | None) -> int:
    try:
        return int(text or "", 16 if (text or "")[:2].lower() == "0x" else 10)
    except ValueError:
        return 0
