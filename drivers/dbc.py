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
from typing import NamedTuple

import numpy as np
from cantools.database.can import Database

from drivers.codec import Codec, check_range, compile_message, in_range
from drivers.crc import RESIDUE, TABLE, crc8, identifier_state, intact
from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import (
    ALWAYS,
    ERROR,
    EXTENDED,
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
_BYTES = [bytes([value]) for value in range(256)]
_new = tuple.__new__
"""Makes a NamedTuple of a tuple in half the time that its own constructor takes."""
_STATES = len(DriveState)
_FAULTS = len(DriveFault)
_MODES = len(DriveMode)
_REACTIONS = len(Reaction)


def legs_dbc() -> str:
    """Return the text of legs.dbc, for the log and for other tools."""
    return resources.files("drivers").joinpath("legs.dbc").read_text(encoding="ascii")


class _CommandFrame(NamedTuple):
    """One command frame of the layout."""

    codec: Codec
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
        self._estop = compile_message(get("ESTOP"), "Source")
        self._sync = compile_message(get("SYNC"), "Cycle")
        self._config = compile_message(get("CONFIG_1"), "Watchdog", "Reaction", "Leg", "CRC")
        self._status = compile_message(get("STATUS_1"), "State", "Fault")
        quantities = ("Length", "Rate") if layout == "classic" else ("Length", "Rate", "Force")
        feedback = get(f"FEEDBACK_{layout.upper()}_1")
        self._feedback = compile_message(feedback, *quantities, "Counter", "State", "CRC")
        self._has_force = "Force" in quantities
        self._exact = self._feedback.exact
        # m, m/s, N; the last one stands idle in a layout without force.
        self._feedback_scale = self._feedback.scale[:3]
        self._commands: list[_CommandFrame] = []
        first = 0
        for name in _COMMANDS[layout]:
            legs = tuple(range(first, first + LEGS // len(_COMMANDS[layout])))
            codec = compile_message(get(name), *(f"Force{leg + 1}" for leg in legs), "Counter", "Mode", "CRC")
            self._commands.append(_CommandFrame(codec, legs, identifier_state(codec.id)))
            first = legs[-1] + 1

        feedback_id = [self._feedback.id - 1 + node for node in nodes]
        self._feedback_ids = frozenset(feedback_id)
        # Per leg: identifier, CRC register after it.
        self._feedback_key = [(identifier, identifier_state(identifier)) for identifier in feedback_id]
        self._status_id = [self._status.id - 1 + node for node in nodes]
        self._config_id = [self._config.id - 1 + node for node in nodes]
        # Controller side: identifier -> (leg, CRC register), the register is -1 for a status.
        self._heard = {
            **{identifier: (leg, -1) for leg, identifier in enumerate(self._status_id)},
            **{identifier: (leg, register) for leg, (identifier, register) in enumerate(self._feedback_key)},
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
                    check_range(codec, part)
                    data = codec.pack(*part, last)
                else:
                    scale = codec.scale[0]
                    data = codec.pack(*[round(f / scale) for f in part], last)
            except (struct.error, ValueError, OverflowError):
                raise self._unfit(codec, force) from None
            frames.append(_new(Frame, (codec.id, data + _BYTES[crc8(data, state)], codec.flags)))
        return tuple(frames)

    def _unfit(self, codec: Codec, force: list[float]) -> ProtocolError:
        return ProtocolError(
            f"force command {force} N does not fit layout {self.layout}: {codec.low[0]:.12g} to "
            f"{codec.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return the frame that faults all drives at once."""
        return (Frame(self._estop.id, b"\0", self._estop.flags),)

    def decode(
        self, frames: Sequence[Received], tick: int, previous: Measurement, since_ns: int = ALWAYS
    ) -> Measurement:
        """Fold this tick's frames into the previous Measurement and return a new one.

        Every leg first ages by the ticks since the previous Measurement, up to NEVER. A feedback whose
        counter is this tick's has age 0, unless it came before `since_ns`: then it answers an older SYNC with
        the same four bits, and is refused. One whose counter lies d = 1..8 ticks back takes effect with age d
        if that is newer than what is held, else it is passed over; any other counter is refused. Refused as
        well, and counted in `rejected`: wrong length, CRC, state or fault, a value that is not finite.
        Foreign frames are ignored. Fault comes from the status, state from the feedback. Layout classic
        carries no force: it stays as it was.
        """
        length = previous.length.copy()
        rate = previous.rate.copy()
        force = previous.force.copy()
        state, fault = previous.state, previous.fault
        held_state, held_age = state.tolist(), previous.age.tolist()
        gone = tick - previous.tick if previous.tick >= 0 else 1
        age = [min(NEVER, n + gone) for n in held_age]
        rejected = 0
        heard, has_force = self._heard, self._has_force
        feedback = self._feedback
        size, unpack, exact = feedback.length, feedback.unpack, feedback.exact
        scale_l, scale_dl, scale_f = self._feedback_scale
        table = TABLE
        last_before = -1
        f = 0
        for t_ns, (identifier, data, flags) in frames:
            if identifier not in heard or flags & _FOREIGN:
                continue
            leg, register = heard[identifier]
            if register < 0:
                if len(data) != self._status.length or data[0] >= _STATES or data[1] >= _FAULTS:
                    rejected += 1
                elif fault[leg] != data[1]:
                    fault = fault.copy()
                    fault[leg] = data[1]
                continue
            for byte in data:  # crc8, without six calls a tick
                register = table[register ^ byte]
            if len(data) != size or register != RESIDUE:
                rejected += 1
                continue
            if has_force:
                l, dl, f, last = unpack(data)
            else:
                l, dl, last = unpack(data)
            if last != last_before:  # the six legs mostly agree
                last_before = last
                behind = (tick - last) & 0xF
                drive_state = last >> 4
                credible = behind <= _OLDEST and drive_state < _STATES
            early = behind == 0 and t_ns < since_ns
            # Integer fields cannot leave their range.
            if early or not credible or (exact and not in_range(feedback, (l, dl, f))):
                rejected += 1
            elif behind < age[leg]:
                length[leg] = l * scale_l
                rate[leg] = dl * scale_dl
                if has_force:
                    force[leg] = f * scale_f
                if held_state[leg] != drive_state:
                    held_state[leg] = drive_state
                    state = np.array(held_state, np.int64)
                age[leg] = behind
        ages = previous.age if age == held_age else np.array(age, np.int64)
        return Measurement(length, rate, force, state, fault, ages, rejected, tick)

    def fresh(self, frame: Frame, tick: int) -> bool:
        """Tell whether a frame is a feedback to this tick's SYNC; its CRC is checked by `decode`."""
        return (
            frame.id in self.feedback_ids
            and len(frame.data) == self._feedback.length
            and (tick - self._feedback.unpack(frame.data)[-1]) & 0xF == 0
        )

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
        if not intact(data, register):
            return Rejected("CRC of a command")
        *raw, last = codec.unpack(data)
        if last >> 4 >= _MODES:
            return Rejected(f"mode {last >> 4}")
        if self._exact:
            if not in_range(codec, raw):
                return Rejected("force not finite or out of range")
            return DeviceCommand(legs, last >> 4, tuple(raw), last & 0xF)
        scale = codec.scale[0]
        return _new(DeviceCommand, (legs, last >> 4, tuple([f * scale for f in raw]), last & 0xF))

    def _parse_config(self, leg: int, register: int, data: bytes) -> DeviceMessage:
        codec = self._config
        if len(data) != codec.length or not intact(data, register):
            return Rejected("length or CRC of CONFIG")
        watchdog, reaction, slot = codec.unpack(data)
        if watchdog < 1 or reaction >= _REACTIONS or slot != leg + 1:
            return Rejected(f"CONFIG with watchdog {watchdog} us, reaction {reaction}, leg {slot}")
        return Configure(leg, watchdog * codec.scale[0], Reaction(reaction))

    def feedback(self, feedback: Feedback) -> Frame:
        """Encode one drive's feedback; what exceeds its field saturates. Raises ProtocolError on NaN."""
        leg, l, dl, f, state, counter = feedback
        codec = self._feedback
        scale_l, scale_dl, scale_f = self._feedback_scale
        last = state << 4 | counter & 0xF
        try:
            if self._exact:
                check_range(codec, (l, dl, f))
                data = codec.pack(l, dl, f, last)
            elif self._has_force:
                data = codec.pack(round(l / scale_l), round(dl / scale_dl), round(f / scale_f), last)
            else:
                data = codec.pack(round(l / scale_l), round(dl / scale_dl), last)
        except (struct.error, ValueError, OverflowError):
            data = self._saturated(feedback, last)
        identifier, register = self._feedback_key[leg]
        return _new(Frame, (identifier, data + _BYTES[crc8(data, register)], codec.flags))

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


def _parse_estop(_data: bytes) -> DeviceMessage:
    return EmergencyStop()
