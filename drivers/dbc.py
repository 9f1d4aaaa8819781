"""Codec of any polled drive whose frames a DBC describes, by the names of its signals.

One frame polls a drive; its answer carries position and velocity, and torque, fault and enabling where it has
them. One signal commands the torque, or the current. The DBC describes the drive with number `dbc_node`; the
identifiers of another drive differ by the difference of the numbers.
"""

from functools import cached_property
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import data_at, record_at
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.frame_pointers import place_of
from drivers.motor_kernels import FALLS, MAPPED
from drivers.motor_settings import Options, refuse_torque, unwatched
from drivers.motors import ANY, NO_BRAKE, MotorProtocol, push
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, Frame, Resolution, Traits
from drivers.sensing.dbc import DRIVES_DBC, found_signal, parsed_dbc, placed, refers, selection
from drivers.sensing.kernels import field_of, put_field, real_of, rows_at, selected
from drivers.sensing.layout import FLOAT, ROW, UNSIGNED
from drivers.signals import LEGS

POSITION, VELOCITY, TORQUE, FAULT, ENABLED = range(5)
ANSWER, COMMAND = range(2)
"""Rows of the mapping."""
_ROLES = ("position", "velocity", "torque", "fault", "enabled")
_BITS = ("poll", "enable", "disable", "clear")
_turn = {"turn": 1.0, "turns": 1.0, "rev": 1.0, "deg": 1 / 360, "rad": 0.5 / np.pi, "°": 1 / 360}
_FACTORS: dict[str, dict[str, float]] = {
    "position": _turn,
    "velocity": {"rpm": 1 / 60, **{f"{name}/s": factor for name, factor in _turn.items()}},
    "torque": {"N m": 1.0, "Nm": 1.0, "N.m": 1.0, "N*m": 1.0, "mNm": 1e-3, "kNm": 1e3},
    "current": {"A": 1.0, "mA": 1e-3},
}
"""Quantity -> units of its signal, each with its factor to turns, turns/s, N m or A."""
TABLE = np.dtype([("rows", "<i8"), *((name, "<i8") for name in _BITS), ("cycles", "<i8")])
"""Address of the rows ANSWER and COMMAND; eight bytes of the frames; 1: a frame of its own enables."""
table_at = record_at(record(TABLE))


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Decode the answer of a drive into `heard` (HEARD record); 0: another frame."""
    row = rows_at(table_at(ear.table).rows, 2)[ANSWER]
    if frame.flags & (FD | REMOTE | ERROR) or frame.flags & EXTENDED != row.flags:
        return 0
    to = place_of(int(frame.id), ear.nodes)
    if to >= 0:
        return motors.says(heard, to, motors.FOREIGN)
    leg = place_of(int(frame.id), ear.replies)
    if leg < 0:
        return 0
    if frame.length != row.length:
        return motors.says(heard, leg, motors.BROKEN)
    if not selected(row, frame.data)[0]:
        return 0
    motors.says(heard, leg, motors.FEEDBACK | motors.MOTION)
    word, fault, enabled, reports = np.zeros(1, np.int64), 0, False, False
    for k in range(row.fields):
        to, raw = row.to[k], real_of(row, k, frame.data, word)
        x = raw * row.scale[k] + row.offset[k]
        if not np.isfinite(x):
            return motors.says(heard, leg, motors.FEEDBACK)
        if to == POSITION:
            heard.turns = x
        elif to == VELOCITY:
            heard.speed = x
        elif to == TORQUE:
            heard.torque, heard.has = x, heard.has | motors.TORQUE
        elif to == FAULT:
            fault = int(raw)
        else:
            enabled, reports = raw != 0.0, True
    return motors.powers(ear, heard, fault, enabled) if reports or fault else 1


@helper
def is_frame(data: Any, number: int) -> bool:
    """True if the eight bytes of a frame are those of `number`."""
    return field_of(data, 0, 64, 0) == number


class DbcProtocol(MotorProtocol):
    """Codec of six polled drives by the signals of a DBC file."""

    ear, commanding, rule = hear, push, FALLS
    number_at = 0, ANY

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        units = tuple(f"{each}_unit" for each in ("position", "velocity", "torque", "command"))
        known = "dbc", "dbc_node", *_ROLES, "current", "command", "torque_constant_Nm_A", "answers_command"
        o = Options(bus, drives, "dbc", "classic", (*known, *_BITS, *units))
        given, self._given = drives.options, drives.options
        self._echoes = o.flag("answers_command", default=True)
        for key in ("dbc", "position", "velocity", "command", "poll", "disable"):
            if not isinstance(given.get(key), str) or not given[key]:
                raise ConfigurationError(
                    f"drives.options: mapping of protocol dbc is incomplete, missing: {key}"
                )
        if (
            "enable" in given and "enabled" not in given
        ):  # a lost frame would leave a drive disabled, unnoticed
            raise ConfigurationError("drives.options: enable needs the signal enabled, missing: enabled")
        self._text = str(given["dbc"])
        if refers(drives):
            raise ConfigurationError(f"drives.options.dbc: no such file: {self._text}")
        self._database = parsed_dbc(self._text, "drives.options.dbc")
        answer: Any = None
        self.rows = np.zeros(2, ROW)
        for role in (*_ROLES, "current"):
            if role in given:
                answer = self._map(ANSWER, role, answer)
        command = self._map(COMMAND, "command", None)
        if answer.is_extended_frame != command.is_extended_frame:
            raise ConfigurationError("drives.options: command and answer have identifiers of unlike width")
        self.flags = EXTENDED * answer.is_extended_frame
        self.rows["flags"] = self.flags
        shift = np.array(drives.node_ids) - o.whole("dbc_node", 1)
        ids, replies = ((each.frame_id + shift).tolist() for each in (command, answer))
        low, high = min(ids + replies), max(ids + replies)
        if low < 0 or high > (ANY if self.flags else 0x7FF):
            raise ConfigurationError(f"drives.node_ids: they give the identifiers 0x{low:X} to 0x{high:X}")
        if set(ids) & set(replies):
            raise ConfigurationError("drives.options: a command and an answer have the same identifier")
        self._commands = {each: self._bytes(each, command.length) for each in _BITS}
        row = self.rows[COMMAND]
        if row["kind"][0] == UNSIGNED or row["offset"][0]:
            raise ConfigurationError("drives.options: command: allowed: a signed signal without an offset")
        polled = np.frombuffer(self._commands["poll"].ljust(8, b"\0"), np.uint8)
        if selected(row.view(np.recarray), polled)[0]:
            raise ConfigurationError("drives.options: poll: allowed: no frame of the command's torque")
        kind, bits, scale = int(row["kind"][0]), int(row["bits"][0]), abs(float(row["scale"][0]))
        limit = 1e4 if kind == FLOAT else scale * (2.0 ** (bits - 1) - 1)
        step = 0.0 if kind == FLOAT else scale
        field = data_at(self.rows[COMMAND:]), MAPPED, step
        super().__init__(o.transmission, ids, field, bus.legs, replies)
        self.torque_limit, self.clears = limit, "clear" in given
        table = self._table = np.zeros((), TABLE)
        table["rows"], table["cycles"] = data_at(self.rows), "enable" in given
        for name in _BITS:
            table[name] = int.from_bytes(self._commands[name].ljust(8, b"\0"), "little", signed=True)
        self.tables["table"], self.tables["replies"] = data_at(table), replies
        refuse_torque(o.transmission, drives.force_limit_N, limit, "dbc")
        self.polls = self._to_each(self._commands["poll"])

    def _map(self, row: int, role: str, before: Any) -> Any:
        """Message of a role's signal, which becomes a field of a row."""
        message, signal = found_signal(self._database, str(self._given[role]), "drives.options.dbc")
        if before is not None and message.name != before.name:
            raise ConfigurationError(
                f"drives.options: {role}: allowed: a signal of {before.name}, as one answer carries all, "
                f"given: {message.name}.{signal.name}"
            )
        if message.is_fd or message.length > 8:
            raise ConfigurationError(f"drives.options: {role}: {message.name} is no classic frame")
        if role == "fault":
            self.fault_names = {code: str(name) for code, name in (signal.choices or {}).items()}
        to = self.rows[row]
        k = int(to["fields"])
        start, bits, kind, big = placed(signal)
        if kind == FLOAT and (bits != 32 or big or start % 8):
            raise ConfigurationError(f"drives.options: {role}: {signal.name} is no little-endian single")
        factor = 1.0 if role in ("fault", "enabled") else self._factor(role, signal)
        to["length"], to["fields"] = message.length, k + 1
        to["to"][k] = 0 if row else TORQUE if role == "current" else _ROLES.index(role)
        for name, value in (("start", start), ("bits", bits), ("kind", kind), ("big", big)):
            to[name][k] = value
        to["scale"][k], to["offset"][k] = float(signal.scale) * factor, float(signal.offset) * factor
        for c, each in enumerate(selection(message, signal)):
            to["conditions"] = 1
            to["at"][c], to["wide"][c], to["from_top"][c] = each.start, each.bits, each.big
            to["mask"][c], to["equals"][c], to["selects"][c] = each.mask, each.equals, 1
        return message

    def _factor(self, role: str, signal: Any) -> float:
        unit = str(
            self._given.get(f"{'torque' if role == 'current' else role}_unit", signal.unit or "")
        ).strip()
        kinds = ("torque", "current") if role == "command" else (role,)
        kind = next((each for each in kinds if unit in _FACTORS[each]), None)
        if kind is None:
            allowed = ", ".join(name for each in kinds for name in _FACTORS[each])
            raise ConfigurationError(
                f"drives.options: {role}: signal {signal.name} has the unit {unit!r}, allowed: {allowed}"
            )
        if kind != "current":
            return _FACTORS[kind][unit]
        constant = self._given.get("torque_constant_Nm_A")
        if isinstance(constant, bool | str | None) or not constant > 0.0:
            raise ConfigurationError(
                f"drives.options: {role}: signal {signal.name} is a current, missing: torque_constant_Nm_A"
            )
        return _FACTORS[kind][unit] * constant

    def _bytes(self, key: str, length: int) -> bytes:
        text = str(self._given.get(key, ""))
        try:
            data = bytes.fromhex(text) if text else b""
        except ValueError:
            data = bytes(9)
        if len(data) not in (0, length):
            raise ConfigurationError(
                f"drives.options: {key}: allowed: {length} bytes in hexadecimal, in quotes, given: {text}"
            )
        return data

    def _to_each(self, data: bytes) -> tuple[Frame, ...]:
        return self.to_each(Frame(node, data, self.flags) for node in self.nodes)

    def blank(self, row: int) -> bytes:
        """Bytes of a row's message with 0 in all fields, and its multiplexer."""
        to, data = self.rows[row], np.zeros(8, np.uint8)
        for c in range(int(to["conditions"])):
            put_field(
                int(to["equals"][c]), data, int(to["at"][c]), int(to["wide"][c]), int(to["from_top"][c])
            )
        return data.tobytes()[: int(to["length"])]

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Properties of the mapping: no watchdog is set, a stop disables each drive and does not latch."""
        t, row = self.transmission, self.rows[ANSWER]
        step = {}
        for k in range(int(row["fields"])):
            step[int(row["to"][k])] = abs(float(row["scale"][k])) * (row["kind"][k] != FLOAT)
        k = row["to"].tolist().index(POSITION)
        bits, signed = int(row["bits"][k]), row["kind"][k] == 1
        ends = np.array([-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1] if signed else [0.0, 2.0**bits - 1])
        most = float(np.abs(ends * row["scale"][k] + row["offset"][k]).max())
        force = t.N_per_Nm * self.torque_field[2]
        length, rate = (t.rate(np.full(LEGS, step[role])) for role in (POSITION, VELOCITY))
        power_told: Any = "feedback" if "enabled" in self._given else "never"
        answers = tuple(Frame(each, self.blank(ANSWER), self.flags) for each in self.wanted)
        return self.traits_of(
            answers,
            family="dbc",
            database=(DRIVES_DBC, self._text),
            echoes=self.to_each(answers) if self._echoes else (),
            emergency_stop=self._to_each(self._commands["disable"]),
            resolution=Resolution.of(length, rate, force),
            reported_lengths=None if row["kind"][k] == FLOAT else t.lengths_within(most),
            has_watchdog=False,
            power_told=power_told,
            dangers=(NO_BRAKE, unwatched("dbc")),
        )

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames by purpose: disable, clear a fault, enable, torque."""
        drive, bits = self.blank(COMMAND), self._commands
        rows = bits["disable"], bits["clear"] or bits["disable"], bits["enable"] or drive, drive
        return tuple(self._to_each(each) for each in rows)
