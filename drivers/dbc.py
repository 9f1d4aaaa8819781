"""Codec of any drive whose frames a DBC describes, by the names of its signals.

A frame polls a drive, and one answer carries position and velocity, and torque, fault and enabling where it
has them. Or the drive sends its messages by a timer (`period_ms`), and one of each is a reading. One signal
commands the torque, or the current. The DBC describes the drive with number `dbc_node`; the identifiers of
another drive differ by the difference of the numbers.
"""

from functools import cached_property
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import data_at, record_at
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_pointers import place_of
from drivers.motor_kernels import FALLS, MAPPED
from drivers.motor_settings import Options, refuse_torque, unwatched
from drivers.motors import ANY, NO_BRAKE, MotorProtocol, push
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Resolution, Traits
from drivers.sensing.dbc import (
    DRIVES_DBC,
    bits_of,
    found_signal,
    frame_of,
    parsed_dbc,
    placed,
    refers,
    selection,
)
from drivers.sensing.family import Field, fill_condition, fill_field
from drivers.sensing.kernels import field_of, put_field, real_of, rows_at, selected
from drivers.sensing.layout import FLOAT, ROW, SIGNED, UNSIGNED, raw_ends
from drivers.signals import LEGS

POSITION, VELOCITY, TORQUE, FAULT, ENABLED = range(5)
COMMAND, ANSWER = range(2)
"""First rows of the mapping; further messages of a drive follow."""
POLL, ENABLE, DISABLE, CLEAR = range(4)
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
TABLE = np.dtype([("rows", "<i8"), ("size", "<i8"), ("frames", "<i8", (len(_BITS), 3))])
"""Address and number of the rows; of the frames POLL to CLEAR: eight bytes, identifier less the drive's
number, and length, -1 for none. `id` of a row is its identifier less that number, too."""
table_at = record_at(record(TABLE))


@helper
def _read(ear: Any, row: Any, data: Any, heard: Any) -> int:
    """Add the values of a message to `heard`; returns 1."""
    heard.has = motors.FEEDBACK | motors.MOTION
    word, fault, enabled, reports = np.zeros(1, np.int64), 0, False, False
    for k in range(row.fields):
        to, raw = row.to[k], real_of(row, k, data, word)
        x = raw * row.scale[k] + row.offset[k]
        if not np.isfinite(x):
            heard.has = motors.FEEDBACK
            return 1
        if to == POSITION:
            heard.turns = x
        elif to == VELOCITY:
            heard.speed = x
        elif to == TORQUE:
            heard.torque, heard.has = x, heard.has | motors.TORQUE
        elif to == FAULT:
            fault, reports = int(raw), reports or raw != 0.0
        else:
            enabled, reports = raw != 0.0, True
    return motors.powers(ear, heard, fault, enabled) if reports else 1


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Decode a message of a drive into `heard` (HEARD record); 0: another frame."""
    table = table_at(ear.table)
    rows = rows_at(table.rows, table.size)
    if frame.flags & (FD | REMOTE | ERROR) or frame.flags & EXTENDED != rows[COMMAND].flags:
        return 0
    for k in range(table.size):
        row = rows[k]
        leg = place_of(int(frame.id) - row.id, ear.nodes)
        if leg < 0:
            continue
        if k == COMMAND:
            return motors.says(heard, leg, motors.FOREIGN)
        if frame.length != row.length:
            return motors.says(heard, leg, motors.BROKEN)
        if selected(row, frame.data)[0]:
            motors.says(heard, leg, 0)
            heard.part = k - ANSWER
            return _read(ear, row, frame.data, heard)
    return 0


@helper
def kind_of(table: Any, frame: Any, node: int) -> int:
    """POLL to CLEAR; -1 for another frame to the drive with this number."""
    data, kind = field_of(frame.data, 0, 64, 0), frame.id - node
    for k in range(len(_BITS)):
        if table.frames[k, 0] == data and table.frames[k, 1] == kind and table.frames[k, 2] == frame.length:
            return k
    return -1


def ends_of(bits: int, kind: int, scale: float, offset: float) -> tuple[float, float]:
    """Smallest and largest value of a field; of a signed one without its lowest code, unlike in the DBC."""
    if kind == FLOAT:
        return -np.inf, np.inf
    least, most = raw_ends(bits, kind)
    low, high = sorted(code * scale + offset for code in (least + (kind == SIGNED), most))
    return low, high


class DbcProtocol(MotorProtocol):
    """Codec of six drives by the signals of a DBC file."""

    ear, commanding, rule = hear, push, FALLS

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        units = tuple(f"{each}_unit" for each in ("position", "velocity", "torque", "command"))
        known = "dbc", "dbc_node", *_ROLES, "current", "command", "torque_constant_Nm_A", "answers_command"
        o = Options(bus, drives, "dbc", "classic", (*known, "period_ms", *_BITS, *units))
        given, self._given = drives.options, drives.options
        self._period_s = 1e-3 * o.positive("period_ms", 1.0) if "period_ms" in given else 0.0
        self._echoes = o.flag("answers_command", default=not self._period_s)
        self._refuse_incomplete()
        self._text = str(given["dbc"])
        if refers(drives):
            raise ConfigurationError(f"drives.options.dbc: no such file: {self._text}")
        self._database = parsed_dbc(self._text, "drives.options.dbc")
        self.rows, self._messages = np.zeros(1 + len(_ROLES), ROW), list[Any]()
        self._used: list[set[int]] = []
        for role in ("command", *_ROLES, "current"):
            if role in given:
                self._map(role)
        self.rows = self.rows[: len(self._messages)]
        command, node = self._messages[COMMAND], o.whole("dbc_node", 1)
        self.flags = EXTENDED * command.is_extended_frame
        self.rows["flags"] = self.flags
        frames = [self._frame(each, command) for each in _BITS]
        base, nodes = self._numbers(frames, np.array(drives.node_ids) - node)
        self._frames = [each and each._replace(id=each.id - base) for each in frames]
        self._refuse_commands()
        row = self.rows[COMMAND]
        step = 0.0 if row["kind"][0] == FLOAT else abs(float(row["scale"][0]))
        limit = min(-row["low"][0], row["high"][0], 1e4 if not step else np.inf)
        field = data_at(self.rows[COMMAND:]), MAPPED, step
        replies = [int(self.rows["id"][ANSWER]) + each for each in nodes]
        super().__init__(o.transmission, nodes, field, bus.legs, replies)
        self.torque_limit, self.clears = float(limit), "clear" in given
        table = self._table = np.zeros((), TABLE)
        table["rows"], table["size"] = data_at(self.rows), len(self.rows)
        for k, each in enumerate(self._frames):
            data = b"" if each is None else each.data
            number = int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)
            table["frames"][k] = (0, 0, -1) if each is None else (number, each.id, len(data))
        self.tables["table"] = data_at(table)
        self.tables["parts"] = (len(self.rows) - ANSWER) * (self._period_s > 0.0)
        refuse_torque(o.transmission, drives.force_limit_N, self.torque_limit, "dbc")
        self.polls = () if self._period_s else self._to_each(self._frames[POLL])

    def _refuse_incomplete(self) -> None:
        given = self._given
        for key in ("dbc", "position", "velocity", "command", "disable", *("poll",) * (not self._period_s)):
            if not given.get(key):
                also = ", or period_ms for a drive that sends by a timer" * (key == "poll")
                raise ConfigurationError(
                    f"drives.options: mapping of protocol dbc is incomplete, missing: {key}{also}"
                )
        for one, other in (("poll", "period_ms"), ("torque", "current")):
            if one in given and other in given:
                raise ConfigurationError(f"drives.options: {one} and {other}, allowed: one of them")
        if "enable" in given and "enabled" not in given:  # else a lost frame would go unnoticed
            raise ConfigurationError("drives.options: enable needs the signal enabled, missing: enabled")

    def _map(self, role: str) -> None:
        """Make a role's signal a field of the row of its message."""
        message, signal = found_signal(self._database, str(self._given[role]), "drives.options.dbc")
        if message.is_fd or message.length > 8:
            raise ConfigurationError(f"drives.options: {role}: {message.name} is no classic frame")
        selects = selection(message, signal)
        at = self._row(role, message, signal, selects)
        to = self.rows[at]
        k = int(to["fields"])
        start, bits, kind, big = placed(signal)
        if kind == FLOAT and (bits != 32 or big or start % 8 or role in ("fault", "enabled")):
            raise ConfigurationError(f"drives.options: {role}: {signal.name} is no little-endian single")
        if role in ("fault", "enabled"):
            kind = UNSIGNED  # bits: an error code of all ones is no -1
        if role == "fault":
            self.fault_names = {code: str(name) for code, name in (signal.choices or {}).items()}
        bit_numbers = {bit for each in selects for bit in bits_of(each.start, each.bits, big=each.big)}
        own = bits_of(start, bits, big=big)
        if own & (self._used[at] | bit_numbers):
            raise ConfigurationError(f"drives.options: {role}: {signal.name} shares bits with another signal")
        self._used[at] |= own | bit_numbers
        factor = 1.0 if role in ("fault", "enabled") else self._factor(role, signal)
        scale, offset = float(signal.scale) * factor, float(signal.offset) * factor
        low, high = ends_of(bits, kind, scale, offset)
        if signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum:
            stated = sorted(factor * float(end) for end in (signal.minimum, signal.maximum))
            low, high = max(low, stated[0]), min(high, stated[1])
        if not np.isfinite([scale, offset]).all() or scale == 0.0 or not low < high:
            raise ConfigurationError(
                f"drives.options: {role}: {signal.name} has no range: scale {signal.scale:g}, "
                f"minimum {signal.minimum}, maximum {signal.maximum}"
            )
        if role in ("command", "velocity", "torque", "current") and not low < 0.0 < high:
            raise ConfigurationError(
                f"drives.options: {role}: allowed: a signed signal, which carries both directions, given: "
                f"{signal.name} with {low / factor:g} to {high / factor:g}"
            )
        to["length"], to["fields"], to["conditions"] = message.length, k + 1, len(selects) or to["conditions"]
        slot = 0 if at == COMMAND else TORQUE if role == "current" else _ROLES.index(role)
        fill_field(to, k, Field(slot, start, bits, scale, offset, kind, big, low, high))
        for c, each in enumerate(selects):
            fill_condition(to, c, each)

    def _row(self, role: str, message: Any, signal: Any, selects: list[Any]) -> int:
        """Row of a signal's message with its value of the multiplexer; a new one if necessary."""
        for at in range(ANSWER, len(self._messages)):
            to = self.rows[at]
            same = not selects or not to["conditions"] or to["equals"][0] == selects[0].equals
            if self._messages[at].name == message.name and same:
                return at
        if len(self._messages) > ANSWER and not self._period_s:
            first = self._messages[ANSWER].name
            raise ConfigurationError(
                f"drives.options: {role}: allowed: a signal of {first}, as the poll has one answer, given: "
                f"{message.name}.{signal.name}"
            )
        self._messages.append(message)
        self._used.append(set())
        return len(self._messages) - 1

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
        if isinstance(constant, bool | str | None) or not 0.0 < constant < np.inf:
            raise ConfigurationError(
                f"drives.options: {role}: signal {signal.name} is a current, missing: torque_constant_Nm_A"
            )
        return _FACTORS[kind][unit] * constant

    def _frame(self, key: str, command: Any) -> Frame | None:
        """Frame to the drive `dbc_node`; without an identifier it has that of the command."""
        if key not in self._given:
            return None
        text, wide = str(self._given[key]), 8 if command.is_extended_frame else 3
        own = "#" in text
        found = frame_of(text if own else f"{command.frame_id:0{wide}X}#{text}")
        if found is None or found.flags != self.flags or not (own or len(found.data) == command.length):
            raise ConfigurationError(
                f"drives.options: {key}: allowed: {command.length} bytes in hexadecimal, in quotes, or "
                f"ID#BYTES with an identifier of {wide} digits, given: {text}"
            )
        return found

    def _numbers(self, frames: list[Frame | None], shift: Any) -> tuple[int, list[int]]:
        """Number of the drive `dbc_node` within its identifiers, and numbers of the six drives."""
        command, *answers = (each.frame_id for each in self._messages)
        if len({each.is_extended_frame for each in self._messages}) > 1:
            raise ConfigurationError("drives.options: command and answer have identifiers of unlike width")
        own = {each.id for each in frames if each is not None} - {command}
        mask = 0xFF if own else ANY
        for each in own:
            if (each - command) & mask:
                raise ConfigurationError(
                    f"drives.options: identifiers 0x{each:X} and 0x{command:X} of frames to one drive: "
                    "allowed: equal last two digits"
                )
        base = command & mask
        self.number_at, nodes = (0, mask), (base + shift).tolist()
        self.rows["id"] = np.array([command, *answers]) - base
        given = sorted({command, *own}), sorted(set(answers))
        each_id = [number - base + node for number in (*given[0], *given[1]) for node in nodes]
        low, high = min(each_id), max(each_id)
        if low < 0 or high > (ANY if self.flags else 0x7FF) or not 0 <= min(nodes) <= max(nodes) <= mask:
            raise ConfigurationError(f"drives.node_ids: they give the identifiers 0x{low:X} to 0x{high:X}")
        if len(set(each_id)) < len(each_id):
            twice = next(each for each in each_id if each_id.count(each) > 1)
            raise ConfigurationError(
                f"drives.options: two messages or drives have the same identifier, 0x{twice:X}: allowed: "
                "node_ids and dbc_node for which all differ"
            )
        return base, nodes

    def _refuse_commands(self) -> None:
        """Refuse a frame that is a torque, or that is another frame as well."""
        row = self.rows[COMMAND]
        if row["offset"][0]:
            raise ConfigurationError("drives.options: command: allowed: a signal without an offset")
        seen: dict[Frame, str] = {}
        for key, frame in zip(_BITS, self._frames, strict=True):
            if frame is None:
                continue
            data = np.frombuffer(frame.data.ljust(8, b"\0"), np.uint8)
            if frame.id == row["id"] and selected(row.view(np.recarray), data)[0]:
                raise ConfigurationError(
                    f"drives.options: {key}: allowed: no frame of the command's torque; another frame of the "
                    "drive, with its identifier: ID#BYTES"
                )
            other = seen.setdefault(frame, key)
            if other != key and (other, key) != ("disable", "clear"):
                raise ConfigurationError(f"drives.options: {other} and {key} are the same frame")

    def _to_each(self, frame: Frame | None) -> tuple[Frame, ...]:
        assert frame is not None
        return self.to_each(frame._replace(id=frame.id + node) for node in self.nodes)

    def blank(self, row: int) -> Frame:
        """A row's message with 0 in all fields, and its multiplexer; identifier less the drive's number."""
        to, data = self.rows[row], np.zeros(8, np.uint8)
        for c in range(int(to["conditions"])):
            put_field(
                int(to["equals"][c]), data, int(to["at"][c]), int(to["wide"][c]), int(to["from_top"][c])
            )
        return Frame(int(to["id"]), data.tobytes()[: int(to["length"])], self.flags)

    def check(self, setup: DriveSetup) -> None:
        """As `MotorProtocol.check`; a timer slower than the loop leaves ticks without a reading."""
        super().check(setup)
        if self._period_s * setup.rate_Hz > 1.0 + 1e-9:
            raise ProtocolError(
                f"drives.options: period_ms: {1e3 * self._period_s:g} ms, allowed: up to the loop's period, "
                f"{1e3 / setup.rate_Hz:g} ms; let the drives send more often, or lower loop.rate_Hz"
            )

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Properties of the mapping: no watchdog is set, a stop disables each drive and does not latch."""
        t = self.transmission
        step = {}
        for row in self.rows[ANSWER:]:
            for k in range(int(row["fields"])):
                step[int(row["to"][k])] = abs(float(row["scale"][k])) * (row["kind"][k] != FLOAT)
                if row["to"][k] == POSITION:
                    ends = [t.length(np.full(LEGS, row[name][k])) for name in ("low", "high")]
        force = t.N_per_Nm * self.torque_field[2]
        length, rate = (t.rate(np.full(LEGS, step[role])) for role in (POSITION, VELOCITY))
        power_told: Any = "feedback" if "enabled" in self._given else "never"
        answers = [self._to_each(self.blank(row)) for row in range(ANSWER, len(self.rows))]
        own: dict[str, Any] = {"feedback_ids": frozenset()} if self._period_s else {}
        return self.traits_of(
            [each for one in answers for each in one],
            family="dbc",
            database=(DRIVES_DBC, self._text),
            unasked_s=self._period_s,
            echoes=answers[0] if self._echoes else (),
            emergency_stop=self._to_each(self._frames[DISABLE]),
            resolution=Resolution.of(length, rate, force),
            reported_lengths=(np.minimum(*ends), np.maximum(*ends)) if np.isfinite(ends).all() else None,
            has_watchdog=False,
            power_told=power_told,
            reports_force=bool({"torque", "current"} & set(self._given)),
            dangers=(NO_BRAKE, unwatched("dbc")),
            **own,
        )

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames by purpose: disable, clear a fault, enable, torque."""
        drive, (_, enable, disable, clear) = self.blank(COMMAND), self._frames
        return tuple(map(self._to_each, (disable, clear or disable, enable or drive, drive)))
