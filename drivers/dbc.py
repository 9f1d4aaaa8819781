"""The own protocol, compiled at start from legs.dbc into struct codecs.

Rule of the room: identifiers, positions, scales and lengths come from legs.dbc and from nowhere
else; cantools reads it once, the cyclic path uses `struct` alone. No state, no clock.

CRC: SAE J1850 CRC-8 over identifier (low byte, high byte), then all data bytes but the last;
the last one is the CRC. Fields are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import partial
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
from cantools.database.can import Database

from drivers.crc import crc8, identifier_state
from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import (
    BRS,
    ERROR,
    EXTENDED,
    FD,
    REMOTE,
    Configure,
    DeviceCommand,
    DeviceMessage,
    EmergencyStop,
    Feedback,
    Frame,
    Received,
    Rejected,
    Status,
    Sync,
)
from drivers.signals import LEGS, NEVER, Command, DriveFault, DriveMode, DriveState, Measurement, Reaction

MAX_NODE = 127
_FOREIGN = EXTENDED | REMOTE | ERROR
_OLDEST = 8
"""Of the 16 counter values, these many ticks back count as late; the rest are refused."""
_COMMANDS = {
    "classic": ("COMMAND_CLASSIC_A", "COMMAND_CLASSIC_B"),
    "fd": ("COMMAND_FD",),
    "ideal": ("COMMAND_IDEAL",),
}
LAYOUTS = tuple(_COMMANDS)
_CODES = {
    (4, False, False): "B",
    (8, False, False): "B",
    (16, True, False): "h",
    (32, True, False): "i",
    (32, False, False): "I",
    (64, True, True): "d",
}
_BYTES = [bytes([value]) for value in range(256)]
_STATES = len(DriveState)
_FAULTS = len(DriveFault)
_MODES = len(DriveMode)
_REACTIONS = len(Reaction)


class _Codec(NamedTuple):
    """One message of legs.dbc."""

    id: int
    length: int
    flags: int
    signals: tuple[str, ...]
    pack: Callable[..., bytes]
    """All fields but the CRC."""
    unpack: Callable[[bytes], tuple[Any, ...]]
    scale: tuple[float, ...]
    low: tuple[float, ...]
    """Ranges in SI."""
    high: tuple[float, ...]
    exact: bool
    """Its quantities are float64: they are not rounded, and their range has to be checked."""


def legs_dbc() -> str:
    """Return the text of legs.dbc, for the log and for other tools."""
    return resources.files("drivers").joinpath("legs.dbc").read_text(encoding="ascii")


def _compile(message: Any, *signals: str) -> _Codec:
    """Turn a cantools message into a struct codec; `signals` are the names expected, in order of position."""
    fields = sorted(message.signals, key=lambda s: s.start)
    names = tuple(s.name for s in fields)
    if names != signals:
        raise ProtocolError(f"legs.dbc: {message.name} has the signals {names}, expected {signals}")
    body, at = "<", 0
    for s in fields:
        if s.length == 4 and s.start % 8 == 4:
            continue  # upper half of the byte that the signal before it opened
        key = (s.length, s.is_signed or s.is_float, s.is_float)
        start = s.start // 8
        if s.start % 8 or s.byte_order != "little_endian" or s.offset or key not in _CODES or start < at:
            raise ProtocolError(f"legs.dbc: {message.name}.{s.name} is not a little-endian field on a byte")
        body += f"{start - at}x" + ("" if s.name == "CRC" else _CODES[key])
        at = start + max(1, s.length // 8)
    check = names[-1] == "CRC"
    if at != message.length or (check and fields[-1].length != 8):
        raise ProtocolError(f"legs.dbc: the last field of {message.name} is not its last byte")
    brs = "CANFD_BRS" in message.dbc.attributes and str(message.dbc.attributes["CANFD_BRS"].value) == "1"
    return _Codec(
        id=message.frame_id,
        length=message.length,
        flags=(FD if message.is_fd else 0) | (BRS if brs else 0),
        signals=names,
        pack=struct.Struct(body).pack,
        unpack=struct.Struct(body + "B" * check).unpack,
        scale=tuple(float(s.scale) for s in fields),
        low=tuple(float(s.minimum) for s in fields),
        high=tuple(float(s.maximum) for s in fields),
        exact=fields[0].is_float,
    )


class _CommandFrame(NamedTuple):
    """One command frame of the layout."""

    codec: _Codec
    legs: tuple[int, ...]
    state: int
    """CRC register after the identifier."""


class LegsProtocol:
    """The own protocol in one layout: `classic`, `fd` or `ideal`. Holds compiled tables only.

    `node_ids` are the drives' node numbers, leg order, 1..127, all different.
    Raises ConfigurationError on other node numbers or an unknown layout.
    """

    def __init__(self, layout: str, node_ids: Sequence[int]) -> None:
        if layout not in _COMMANDS:
            raise ConfigurationError(f"bus.layout: {layout!r} is unknown, allowed are {', '.join(LAYOUTS)}")
        nodes = tuple(node_ids)
        if len(nodes) != LEGS or len(set(nodes)) != LEGS or not all(1 <= node <= MAX_NODE for node in nodes):
            raise ConfigurationError(
                f"drives.node_ids: {list(nodes)} given, {LEGS} different numbers from 1 to {MAX_NODE} needed"
            )
        self.layout = layout
        self.node_ids = nodes
        database = Database()
        database.add_dbc_string(legs_dbc())
        get = database.get_message_by_name
        self._estop = _compile(get("ESTOP"), "Source")
        self._sync = _compile(get("SYNC"), "Cycle")
        self._config = _compile(get("CONFIG_1"), "Watchdog", "Reaction", "Leg", "CRC")
        self._status = _compile(get("STATUS_1"), "State", "Fault")
        quantities = ("Length", "Rate") if layout == "classic" else ("Length", "Rate", "Force")
        self._feedback = _compile(get(f"FEEDBACK_{layout.upper()}_1"), *quantities, "Counter", "State", "CRC")
        self._has_force = "Force" in quantities
        self._exact = self._feedback.exact
        self._commands: list[_CommandFrame] = []
        first = 0
        for name in _COMMANDS[layout]:
            legs = tuple(range(first, first + LEGS // len(_COMMANDS[layout])))
            codec = _compile(get(name), *(f"Force{leg + 1}" for leg in legs), "Counter", "Mode", "CRC")
            self._commands.append(_CommandFrame(codec, legs, identifier_state(codec.id)))
            first = legs[-1] + 1

        self._feedback_id = [self._feedback.id - 1 + node for node in nodes]
        self._feedback_state = [identifier_state(identifier) for identifier in self._feedback_id]
        self._feedback_ids = frozenset(self._feedback_id)
        self._status_id = [self._status.id - 1 + node for node in nodes]
        self._config_id = [self._config.id - 1 + node for node in nodes]
        # Controller side: identifier -> (leg, CRC register), the register is -1 for a status.
        self._heard = {
            **{identifier: (leg, -1) for leg, identifier in enumerate(self._status_id)},
            **{
                identifier: (leg, self._feedback_state[leg])
                for leg, identifier in enumerate(self._feedback_id)
            },
        }
        # Device side: identifier -> parser.
        self._parsers: dict[int, Callable[[bytes], DeviceMessage]] = {
            self._estop.id: _parse_estop,
            self._sync.id: self._parse_sync,
            **{command.codec.id: partial(self._parse_command, command) for command in self._commands},
            **{
                identifier: partial(self._parse_config, leg, identifier_state(identifier))
                for leg, identifier in enumerate(self._config_id)
            },
        }

    @property
    def feedback_ids(self) -> frozenset[int]:
        """Identifiers of the six cyclic feedbacks."""
        return self._feedback_ids

    # controller side

    def sync(self, tick: int) -> tuple[Frame, ...]:
        """Return the SYNC frame: the tick modulo 256."""
        return (Frame(self._sync.id, _BYTES[tick & 0xFF], self._sync.flags),)

    def configure(self, watchdog_s: float, reaction: Reaction) -> tuple[Frame, ...]:
        """Return the six CONFIG frames. Raises ProtocolError if the watchdog is not 1 us .. 4294 s."""
        codec = self._config
        try:
            watchdog = round(watchdog_s / codec.scale[0])
            bodies = [codec.pack(watchdog, int(reaction), leg + 1) for leg in range(LEGS)]
        except (struct.error, ValueError, OverflowError):
            watchdog = 0
        if watchdog < 1:
            raise ProtocolError(
                f"drive watchdog of {watchdog_s} s does not fit into CONFIG: "
                "0.000001 to 4294.967295 s are allowed"
            )
        frames = []
        for identifier, body in zip(self._config_id, bodies, strict=True):
            check = crc8(body, identifier_state(identifier))
            frames.append(Frame(identifier, body + _BYTES[check], codec.flags))
        return tuple(frames)

    def command(self, command: Command, tick: int) -> tuple[Frame, ...]:
        """Return one tick's command frames.

        force (6,) N, > 0 extends; the counter is the tick modulo 16.
        Raises ProtocolError if a force is not finite or does not fit the layout's field.
        """
        force = command.force.tolist()
        last = command.mode << 4 | tick & 0xF
        frames = []
        for codec, legs, state in self._commands:
            part = force[legs[0] : legs[-1] + 1]
            try:
                if self._exact:
                    _check_range(codec, part)
                    data = codec.pack(*part, last)
                else:
                    scale = codec.scale[0]
                    data = codec.pack(*[round(f / scale) for f in part], last)
            except (struct.error, ValueError, OverflowError):
                raise self._unfit(codec, force) from None
            frames.append(Frame(codec.id, data + _BYTES[crc8(data, state)], codec.flags))
        return tuple(frames)

    def _unfit(self, codec: _Codec, force: list[float]) -> ProtocolError:
        return ProtocolError(
            f"force command {force} N does not fit layout {self.layout}: {codec.low[0]:.12g} to "
            f"{codec.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return the frame that faults all drives at once."""
        return (Frame(self._estop.id, b"\0", self._estop.flags),)

    def decode(self, frames: Sequence[Received], tick: int, previous: Measurement) -> Measurement:
        """Fold this tick's frames into the previous Measurement and return a new one.

        Every leg first ages by one tick, up to NEVER. A feedback whose counter is this tick's has age 0.
        One whose counter lies d = 1..8 ticks back takes effect with age d if that is newer than what
        is held, else it is passed over; any other counter is refused. Refused as well, and counted
        in `rejected`: wrong length, CRC, state or fault, a value that is not finite. Foreign frames
        are ignored. Fault comes from the status, state from the feedback. Layout classic carries
        no force: it stays as it was.
        """
        length = previous.length.copy()
        rate = previous.rate.copy()
        force = previous.force.copy()
        state = previous.state.copy()
        fault = previous.fault
        age = [n + 1 if n < NEVER else NEVER for n in previous.age.tolist()]
        rejected = 0
        feedback = self._feedback
        size, unpack = feedback.length, feedback.unpack
        scale, low, high, exact = feedback.scale, feedback.low, feedback.high, feedback.exact
        for _, (identifier, data, flags) in frames:
            heard = self._heard.get(identifier)
            if heard is None or flags & _FOREIGN:
                continue
            leg, register = heard
            if register < 0:
                if len(data) != self._status.length or data[0] >= _STATES or data[1] >= _FAULTS:
                    rejected += 1
                elif fault[leg] != data[1]:
                    fault = fault.copy()
                    fault[leg] = data[1]
                continue
            if len(data) != size or crc8(data[:-1], register) != data[-1]:
                rejected += 1
                continue
            if self._has_force:
                l, dl, f, last, _ = unpack(data)
            else:
                l, dl, last, _ = unpack(data)
                f = None
            behind = (tick - last) & 0xF
            drive_state = last >> 4
            # Integer fields cannot leave their range; NaN fails every comparison.
            absurd = exact and not (
                low[0] <= l <= high[0] and low[1] <= dl <= high[1] and low[2] <= f <= high[2]
            )
            if behind > _OLDEST or drive_state >= _STATES or absurd:
                rejected += 1
            elif behind < age[leg]:
                length[leg] = l * scale[0]
                rate[leg] = dl * scale[1]
                if f is not None:
                    force[leg] = f * scale[2]
                state[leg] = drive_state
                age[leg] = behind
        return Measurement(length, rate, force, state, fault, np.array(age, np.int64), rejected)

    # device side

    def parse(self, frame: Frame) -> DeviceMessage | None:
        """Decode at the drives' end; None for a frame that is not for them.

        An E-stop counts whatever its payload. Rejected: wrong length or CRC, unknown mode or
        reaction, a force that is not finite.
        """
        parser = self._parsers.get(frame.id)
        if parser is None or frame.flags & _FOREIGN:
            return None
        return parser(frame.data)

    def _parse_sync(self, data: bytes) -> DeviceMessage:
        if len(data) != self._sync.length:
            return Rejected(f"SYNC of {len(data)} bytes")
        return Sync(data[0])

    def _parse_command(self, command: _CommandFrame, data: bytes) -> DeviceMessage:
        codec, legs, register = command
        if len(data) != codec.length:
            return Rejected(f"command of {len(data)} bytes")
        if crc8(data[:-1], register) != data[-1]:
            return Rejected("CRC of a command")
        *raw, last, _ = codec.unpack(data)
        if last >> 4 >= _MODES:
            return Rejected(f"mode {last >> 4}")
        if self._exact:
            if not _in_range(codec, raw):
                return Rejected("force not finite or out of range")
            return DeviceCommand(legs, last >> 4, tuple(raw), last & 0xF)
        scale = codec.scale[0]
        return DeviceCommand(legs, last >> 4, tuple([f * scale for f in raw]), last & 0xF)

    def _parse_config(self, leg: int, register: int, data: bytes) -> DeviceMessage:
        codec = self._config
        if len(data) != codec.length or crc8(data[:-1], register) != data[-1]:
            return Rejected("length or CRC of CONFIG")
        watchdog, reaction, slot, _ = codec.unpack(data)
        if watchdog < 1 or reaction >= _REACTIONS or slot != leg + 1:
            return Rejected(f"CONFIG with watchdog {watchdog} us, reaction {reaction}, leg {slot}")
        return Configure(leg, watchdog * codec.scale[0], Reaction(reaction))

    def feedback(self, feedback: Feedback) -> Frame:
        """Encode one drive's feedback; what exceeds its field saturates. Raises ProtocolError on NaN."""
        leg, l, dl, f, state, counter = feedback
        codec = self._feedback
        scale = codec.scale
        last = state << 4 | counter & 0xF
        try:
            if self._exact:
                _check_range(codec, (l, dl, f))
                data = codec.pack(l, dl, f, last)
            elif self._has_force:
                data = codec.pack(round(l / scale[0]), round(dl / scale[1]), round(f / scale[2]), last)
            else:
                data = codec.pack(round(l / scale[0]), round(dl / scale[1]), last)
        except (struct.error, ValueError, OverflowError):
            data = self._saturated(feedback, last)
        return Frame(
            self._feedback_id[leg], data + _BYTES[crc8(data, self._feedback_state[leg])], codec.flags
        )

    def status(self, status: Status) -> Frame:
        """Encode one drive's heartbeat."""
        return Frame(
            self._status_id[status.leg], self._status.pack(status.state, status.fault), self._status.flags
        )

    def _saturated(self, feedback: Feedback, last: int) -> bytes:
        """Encode what does not fit its fields at their ends."""
        codec = self._feedback
        values = feedback[1 : len(codec.signals) - 2]
        if any(value != value for value in values):  # noqa: PLR0124 - only NaN differs from itself
            raise ProtocolError(f"feedback of leg {feedback.leg} is not a number: {feedback}")
        ends = [min(max(v, low), high) for v, low, high in zip(values, codec.low, codec.high, strict=False)]
        if self._exact:
            return codec.pack(*ends, last)
        return codec.pack(*[round(v / scale) for v, scale in zip(ends, codec.scale, strict=False)], last)

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: SYNC, commands, six feedbacks."""
        rest = Command(DriveMode.OFF, np.zeros(LEGS))
        feedback = (self.feedback(Feedback(leg, 0.0, 0.0, 0.0, DriveState.OFF, 0)) for leg in range(LEGS))
        return (*self.sync(0), *self.command(rest, 0), *feedback)


def _in_range(codec: _Codec, values: Sequence[float]) -> bool:
    """Tell whether the leading fields are inside the DBC's ranges; a NaN is not."""
    for value, low, high in zip(values, codec.low, codec.high, strict=False):  # noqa: SIM110 - all() takes twice as long
        if not low <= value <= high:
            return False
    return True


def _check_range(codec: _Codec, values: Sequence[float]) -> None:
    if not _in_range(codec, values):
        raise ValueError


def _parse_estop(_data: bytes) -> DeviceMessage:
    return EmergencyStop()
