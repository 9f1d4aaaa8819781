"""Any sensor whose frames a DBC describes, by the names of its signals."""

import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field as Key

from drivers.config import DriveSettings
from drivers.errors import ConfigurationError
from drivers.files import read_regular
from drivers.protocol import BRS, EXTENDED, FD, Frame
from drivers.sensing.family import CHANNELS, UNITS, Condition, Device, Field, Message, Timed, Wanted
from drivers.sensing.layout import FLOAT, SIGNED, UNSIGNED

DRIVES_DBC = "drives.dbc"
"""Name of the drives' DBC in a log."""
_MOST_BYTES = 4_000_000
_g, _deg = 9.80665, 0.017453292519943295
FACTORS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6, "µm": 1e-6, "in": 0.0254},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": _deg, "degree": _deg, "degrees": _deg, "°": _deg},
    "rad/s": {"rad/s": 1.0, "deg/s": _deg, "deg/sec": _deg, "°/s": _deg, "degree/s": _deg},
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "m/s²": 1.0, "m/s/s": 1.0, "g": _g, "mg": 1e-3 * _g},
    "N": {"N": 1.0, "kN": 1e3, "daN": 10.0, "kgf": _g, "lbf": 4.4482216152605},
    "N m": {"N m": 1.0, "Nm": 1.0, "N.m": 1.0, "N*m": 1.0, "kNm": 1e3, "kN m": 1e3, "mNm": 1e-3},
}
"""SI unit -> units that a DBC may state, each with its factor."""
_FRAME = re.compile("([0-7][0-9A-F]{2}|[01][0-9A-F]{7})#([0-9A-F]{2}){0,8}", re.IGNORECASE)
FRAME_FORM = "ID#BYTES in hexadecimal, an identifier of 3 or 8 digits and at most 8 bytes"
_NARROW = 3
"""Digits of an identifier of 11 bits."""
_LONGEST = 56
"""Bits within whole bytes that one field may span, but for fields of 64 bits on a byte boundary."""


_Part = tuple[Any, list[Field], list[Condition]]
"""Message of a DBC, and what is read of it."""


class DbcSensor(Timed):
    """A sensor by the signals of a DBC file."""

    protocol: Literal["dbc"]
    has_node = False
    file: str
    """The DBC file, relative to the configuration file."""
    signals: dict[str, str]
    """Quantity -> signal, as `Signal` or `Message.Signal`. Quantities: x y z rx ry rz of tracker (rx ry rz is
    the rotation vector), wx wy wz fx fy fz of imu, fx fy fz mx my mz of wrench, roll pitch of inclination,
    leg_0 to leg_5 of lengths and forces."""
    units: dict[str, str] = {}
    """Quantity -> unit of its signal, where the DBC states none, or a wrong one."""
    offsets: dict[str, float] = {}
    """Quantity -> constant to add, SI: the leg length at position 0."""
    negative: list[str] = []
    """Quantities whose sign is opposite to that of their signal."""
    valid: dict[str, int] = {}
    """Signal -> raw value that marks a sample as valid; its message is part of each sample."""
    skip: dict[str, int] = {}
    """Signal -> raw value of frames that are not read: the head of a packet of several frames."""
    start: list[str] = []
    """Frames that start the device, `ID#BYTES` in hexadecimal: identifier of 3 digits, extended of 8."""
    source_address: Annotated[int, Key(ge=0, le=253)] | None = None
    """J1939: source address in the identifiers of 29 bits, in place of that of the DBC."""
    trigger: Literal["sync", "free"] = "free"
    """`sync`: sampled at every SYNC. `free`: by the device's own clock; the time of a sample is its arrival
    less latency_ms."""

    def device(self, wanted: Wanted) -> Device:
        """Messages of one measurement."""
        role, (name, text, database) = wanted.role, self._database(wanted.folder)
        names = CHANNELS[role]
        given = (*self.signals, *self.units, *self.offsets, *self.negative)
        if strange := [each for each in given if each not in names]:
            raise ConfigurationError(
                f"signals: unknown quantity, allowed: {', '.join(names)}, given: {strange[0]}"
            )
        missing = [each for each in names if each not in self.signals]
        if missing and (role not in ("imu", "inclination") or len(missing) == len(names)):
            raise ConfigurationError(f"signals: incomplete, missing: {', '.join(missing)}")
        own = (
            {names[wanted.leg]: 0}
            if role in ("lengths", "forces")
            else dict(zip(names, range(6), strict=False))
        )
        return self.timed(
            self.trigger,
            messages=tuple(self._message(*each) for each in self._parts(role, own, database, name)),
            start=tuple(self._start(each) for each in self.start),
            database=text,
        )

    def _parts(self, role: str, own: dict[str, int], database: Any, name: str) -> Iterable[_Part]:
        """Frames of a sample, one for each message and multiplexer value."""
        skipped: dict[str, list[Condition]] = {}
        for each, value in self.skip.items():
            message, signal = found_signal(database, each, name)
            skipped.setdefault(message.name, []).append(_condition(signal, value)._replace(skips=True))
        used = [(self.signals[quantity], quantity, 0) for quantity in own if quantity in self.signals]
        used += [(each, "", value) for each, value in self.valid.items()]
        found = [(*found_signal(database, each, name), quantity, value) for each, quantity, value in used]
        parts: dict[tuple[Any, ...], _Part] = {}
        for message, signal, quantity, value in sorted(found, key=lambda each: not each[1].multiplexer_ids):
            selects = selection(message, signal)
            hosts = [] if selects else [part for key, part in parts.items() if key[0] == message.name]
            skips = [s for s in skipped.get(message.name, []) if all(s.start != of.start for of in selects)]
            hosts = hosts or [parts.setdefault((message.name, *selects), (message, [], [*selects, *skips]))]
            if quantity:
                unit = UNITS[role][CHANNELS[role].index(quantity)]
                hosts[0][1].append(self._field(own[quantity], quantity, signal, unit))
                continue
            for _, _, conditions in hosts:
                conditions.append(_condition(signal, value))
        return parts.values()

    def _start(self, text: str) -> Frame:
        if (frame := frame_of(text)) is None:
            raise ConfigurationError(f"start: allowed: {FRAME_FORM}, given: {text}")
        return frame

    def _database(self, folder: Path) -> tuple[str, str, Any]:
        path = folder / self.file
        try:
            text = dbc_text(read_regular(path, _MOST_BYTES))
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"file: {path}: {getattr(error, 'strerror', error)}") from error
        return path.name, text, parsed_dbc(text, self.file)

    def _field(self, to: int, quantity: str, signal: Any, si: str) -> Field:
        unit = self.units.get(quantity, signal.unit or "")
        factor = FACTORS[si].get(unit.strip())
        if factor is None:
            stated = f"the DBC states {unit!r}" if unit else "the DBC states no unit"
            raise ConfigurationError(
                f"units: {quantity}: {stated} for signal {signal.name}, allowed: {', '.join(FACTORS[si])}; "
                f"state it as units: {{{quantity}: ...}}"
            )
        factor *= -1.0 if quantity in self.negative else 1.0
        start, bits, kind, big = placed(signal)
        scale, shift = float(signal.scale) * factor, self.offsets.get(quantity, 0.0)
        low = high = None
        if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
            ends = sorted(float(end) * factor + shift for end in (signal.minimum, signal.maximum))
            low, high = ends[0] - 0.5 * abs(scale), ends[1] + 0.5 * abs(scale)
        return Field(to, start, bits, scale, float(signal.offset) * factor + shift, kind, big, low, high)

    def _message(self, message: Any, fields: list[Field], conditions: list[Condition]) -> Message:
        flags = EXTENDED * message.is_extended_frame | (FD | BRS) * message.is_fd
        identifier = message.frame_id
        if self.source_address is not None and message.is_extended_frame:
            identifier = identifier & ~0xFF | self.source_address
        return Message(identifier, message.length, tuple(fields), flags, tuple(conditions))


def frame_of(text: str) -> Frame | None:
    """Frame of a text `ID#BYTES`; None if it is malformed."""
    if not _FRAME.fullmatch(text):
        return None
    identifier, _, data = text.partition("#")
    return Frame(int(identifier, 16), bytes.fromhex(data), EXTENDED * (len(identifier) > _NARROW))


def _condition(signal: Any, value: int) -> Condition:
    start, bits, _, big = placed(signal)
    mask = (1 << bits) - 1
    return Condition(start, bits, value & mask, mask, big)


def dbc_text(data: bytes) -> str:
    """Text of a DBC file in UTF-8, else in Windows-1252."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def refers(drives: DriveSettings) -> bool:
    """True if option `dbc` of the drives is the path of a DBC; several lines are its text."""
    given = drives.options.get("dbc")
    return isinstance(given, str) and "\n" not in given


def with_dbc(drives: DriveSettings, folder: Path | None, files: Mapping[str, bytes]) -> DriveSettings:
    """Drives with the text of the DBC that their option refers to.

    The text comes from `folder`, or without a folder from the files of a log. Without a DBC: unchanged.
    """
    if not refers(drives):
        return drives
    try:
        path = str(drives.options["dbc"])
        data = files[DRIVES_DBC] if folder is None else read_regular(folder / path, _MOST_BYTES)
    except (KeyError, OSError, ValueError):
        return drives
    return drives.model_copy(update={"options": drives.options | {"dbc": dbc_text(data)}})


@cache
def parsed_dbc(text: str, file: str) -> Any:
    """Database of a DBC text. Raises ConfigurationError that names `file`."""
    import cantools  # noqa: PLC0415 - takes a third of a second

    try:
        return cantools.database.load_string(text, "dbc", strict=False)
    except Exception as error:
        raise ConfigurationError(f"file: {file} is not a DBC: {error}") from error


def found_signal(database: Any, wanted: str, file: str) -> tuple[Any, Any]:
    """Message and signal of a name."""
    message, _, signal = wanted.rpartition(".")
    found = [
        (each, one)
        for each in database.messages
        for one in each.signals
        if one.name == signal and message in ("", each.name)
    ]
    if len(found) != 1:
        what = "in several messages, allowed: Message.Signal" if found else "unknown"
        where = ", ".join(f"{each.name}.{one.name}" for each, one in found)
        raise ConfigurationError(f"signals: {wanted} of {file}: {what}{where and f', found: {where}'}")
    of, one = found[0]
    if max(bits_of(*placed(one)[:2], big=placed(one)[3])) >= 8 * of.length:
        raise ConfigurationError(f"signals: {wanted} of {file}: beyond the {of.length} bytes of {of.name}")
    return of, one


def bits_of(start: int, bits: int, *, big: bool) -> set[int]:
    """Bits of a field, counted from the highest one of the first byte."""
    first = start ^ 7
    return set(range(first, first + bits)) if big else {bit ^ 7 for bit in range(start, start + bits)}


def placed(signal: Any) -> tuple[int, int, int, bool]:
    """First bit, bits, kind and byte order of a signal."""
    start, bits, big = int(signal.start), int(signal.length), signal.byte_order == "big_endian"
    skipped = 7 - start % 8 if big else start % 8
    if skipped + bits > _LONGEST and (skipped or bits != 64):
        raise ConfigurationError(
            f"signals: {signal.name} has {bits} bits from bit {start}, allowed: within {_LONGEST // 8} "
            "bytes, or 64 bits on a byte boundary"
        )
    return start, bits, FLOAT if signal.is_float else SIGNED if signal.is_signed else UNSIGNED, big


def selection(message: Any, signal: Any) -> list[Condition]:
    """Value of the multiplexer with which a frame has the signal."""
    if not signal.multiplexer_ids:
        return []
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    if len(signal.multiplexer_ids) > 1 or selector.multiplexer_ids:
        raise ConfigurationError(f"signals: {signal.name} is multiplexed twice, allowed: by one value")
    start, bits, _, big = placed(selector)
    return [Condition(start, bits, signal.multiplexer_ids[0], -1, big, selects=True)]
