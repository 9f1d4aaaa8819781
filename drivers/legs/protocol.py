"""The own protocol, compiled at start from legs.dbc into struct codecs and tables.

In the loop the controller's end uses the tables, with `drivers.legs.kernels`, and the drives' end `struct`.
No state, no clock.

CRC: SAE J1850 CRC-8 over identifier (low byte, high byte), then all data bytes but the last;
the last one is the CRC. Fields are little-endian.
"""

import struct
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Ints
from drivers.errors import ConfigurationError, ProtocolError
from drivers.legs.codec import Codec, Place, compile_message, parsed, read_dbc
from drivers.legs.crc import crc8, identifier_state
from drivers.legs.device_kernels import BROKEN, UNFIT, UNKNOWN_MODE, decode_command, encode_feedbacks, intact
from drivers.legs.kernels import FOREIGN, QUANTITIES, encode, fold
from drivers.protocol import (
    ALWAYS,
    Configure,
    DeviceCommand,
    DeviceMessage,
    Dialogue,
    DriveSetup,
    EmergencyStop,
    Frame,
    Memory,
    Received,
    Rejected,
    Status,
    Sync,
)
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record

MAX_NODE = 127
SETUPS = 3
"""How often a drive is sent its CONFIG: nothing acknowledges it."""
SETUP_S = 0.02
"""From one CONFIG of a drive to its next."""
_POWERED = (DriveState.READY, DriveState.RUN)
_COMMANDS = {
    "classic": ("COMMAND_CLASSIC_A", "COMMAND_CLASSIC_B"),
    "fd": ("COMMAND_FD",),
    "ideal": ("COMMAND_IDEAL",),
}
LAYOUTS = tuple(_COMMANDS)
_BYTES = [bytes([value]) for value in range(256)]
_new = tuple.__new__
"""Makes a NamedTuple of a tuple in half the time that its own constructor takes."""
_UNTRUSTED = {
    BROKEN: "CRC of a command",
    UNKNOWN_MODE: "unknown mode",
    UNFIT: "force not finite or out of range",
}
_REACTIONS = len(Reaction)


class LegsDialogue(NamedTuple):
    """What the controller's end remembers."""

    configure: tuple[Frame, ...]
    """CONFIG of each drive."""
    interval: int
    """Ticks from one CONFIG of a drive to its next."""
    sent: tuple[int, ...]
    """How often each drive has been sent its CONFIG."""


class _CommandFrame(NamedTuple):
    """One command frame of the layout."""

    codec: Codec
    legs: tuple[int, ...]
    state: int
    """CRC register after the identifier."""


class LegsProtocol:
    """The own protocol in one layout: `classic`, `fd` or `ideal`. Holds compiled tables only.

    `node_ids` are the drives' node numbers, leg order, 1..127, all different. The drives' end remembers
    nothing: its memory is None. Raises ConfigurationError on other node numbers or an unknown layout.
    """

    command_delay_ticks = 0
    set_up_frames = 1
    reset_ticks = 5

    def __init__(self, layout: str, node_ids: Sequence[int]) -> None:
        if layout not in _COMMANDS:
            raise ConfigurationError(f"bus.layout: {layout!r} is unknown, allowed are {', '.join(LAYOUTS)}")
        nodes = tuple(node_ids)
        if len(nodes) != LEGS or len(set(nodes)) != LEGS:
            raise ConfigurationError(f"drives.node_ids: allowed: {LEGS} different ones, given: {list(nodes)}")
        for leg, node in enumerate(nodes):
            if not 1 <= node <= MAX_NODE:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed: a whole number at least 1 and at most "
                    f"{MAX_NODE}, given: {node}"
                )
        self.layout = layout
        self.node_ids = nodes
        self.database = "legs.dbc", read_dbc("drivers.legs", "legs.dbc")
        get = parsed(self.database[1]).get_message_by_name
        self._estop = compile_message(get("ESTOP"), "Source")
        self._sync = compile_message(get("SYNC"), "Cycle")
        self._config = compile_message(get("CONFIG_1"), "Watchdog", "Reaction", "Leg", "CRC")
        self._status = compile_message(get("STATUS_1"), "State", "Fault")
        quantities = ("Length", "Rate") if layout == "classic" else ("Length", "Rate", "Force")
        feedback = get(f"FEEDBACK_{layout.upper()}_1")
        self._feedback = compile_message(feedback, *quantities, "Counter", "State", "Invalid", "CRC")
        self._has_force = "Force" in quantities
        self._exact = self._feedback.exact
        self._commands: list[_CommandFrame] = []
        first = 0
        for name in _COMMANDS[layout]:
            legs = tuple(range(first, first + LEGS // len(_COMMANDS[layout])))
            codec = compile_message(get(name), *(f"Force{leg + 1}" for leg in legs), "Counter", "Mode", "CRC")
            self._commands.append(_CommandFrame(codec, legs, identifier_state(codec.id)))
            first = legs[-1] + 1

        feedback_id = [self._feedback.id - 1 + node for node in nodes]
        self.feedback_ids = frozenset(feedback_id)
        self._counter_at = self._feedback.place("Counter").start
        self._feedback_legs = list(enumerate(feedback_id))
        # Per leg: identifier, CRC register after it.
        self._feedback_key = [(identifier, identifier_state(identifier)) for identifier in feedback_id]
        self._status_id = [self._status.id - 1 + node for node in nodes]
        self._config_id = [self._config.id - 1 + node for node in nodes]
        self._tabulate()
        # Device side: identifier -> parser.
        self._parsers: dict[int, Callable[[bytes], DeviceMessage]] = {
            self._estop.id: lambda _: EmergencyStop(),
            self._sync.id: self._parse_sync,
            **{command.codec.id: partial(self._parse_command, command) for command in self._commands},
            **{
                identifier: partial(self._parse_config, leg, identifier_state(identifier))
                for leg, identifier in enumerate(self._config_id)
            },
        }

    def _tabulate(self) -> None:
        """Make the tables of `drivers.legs.kernels` and `drivers.legs.device_kernels`."""
        feedback, status, command = self._feedback, self._status, self._commands[0].codec
        ids, registers = zip(*self._feedback_key, strict=True)
        self._identifiers = np.array([*ids, *registers, *self._status_id], np.int64)
        at = [status.place("State").start, status.place("Fault").start, feedback.place("Counter").start]
        places = [*feedback.places[: 3 if self._has_force else 2], Place(0, 0, is_float=False)]
        self._feedback_form = np.array(
            [feedback.length, status.length, *at, self._exact, *chain(*places[:QUANTITIES])], np.int64
        )
        self._feedback_range = np.array([*feedback.scale[:3], *feedback.low[:3], *feedback.high[:3]])
        force = command.places[0]
        frames = [(frame.codec.length, frame.state) for frame in self._commands]
        self._command_form = np.array([*force, command.place("Counter").start, *chain(*frames)], np.int64)
        steps = 1 << 8 * force.size - 1
        ends = (command.low[0], command.high[0]) if self._exact else (-steps, steps - 1)
        self._command_range = np.array([command.scale[0], *ends], float)
        self._command_size = sum(size for size, _ in frames)
        self._split = struct.Struct(f"{feedback.length}s" * LEGS).unpack

    # controller side

    def start(self, setup: DriveSetup) -> LegsDialogue:
        """Return the dialogue before the first CONFIG. Raises ProtocolError as `configure` does."""
        frames = self.configure(setup.watchdog_s, setup.reaction)
        return LegsDialogue(frames, max(LEGS, round(SETUP_S * setup.rate_Hz)), (0,) * LEGS)

    def begin(self, _dialogue: Dialogue, tick: int) -> tuple[Frame, ...]:
        """Return the SYNC frame: the tick modulo 256."""
        return (Frame(self._sync.id, _BYTES[tick & 0xFF], self._sync.flags),)

    def set_up(self, dialogue: LegsDialogue, tick: Record) -> tuple[LegsDialogue, tuple[Frame, ...]]:
        """Return the CONFIG of a drive that is heard and has none from us: one a tick, SETUPS times each."""
        leg = int(tick["tick"]) % dialogue.interval
        if leg >= LEGS or tick["age"][leg] > 1:
            return dialogue, ()
        state, sent = tick["drive_state"][leg], dialogue.sent
        if state != DriveState.BOOT and (sent[leg] >= SETUPS or state in _POWERED):
            return dialogue, ()
        sent = (*sent[:leg], sent[leg] + 1, *sent[leg + 1 :])
        return dialogue._replace(sent=sent), (dialogue.configure[leg],)

    def legs_set_up(self, dialogue: LegsDialogue) -> tuple[bool, ...]:
        """Tell which drives have been sent their CONFIG SETUPS times."""
        return tuple([sent >= SETUPS for sent in dialogue.sent])

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

    def command(self, dialogue: Dialogue, command: Command, tick: int) -> tuple[Dialogue, tuple[Frame, ...]]:
        """Return one tick's command frames.

        force (6,) N, > 0 extends; the counter is the tick modulo 16.
        Raises ProtocolError if a force is not finite or does not fit the layout's field.
        """
        data = np.empty(self._command_size, np.uint8)
        last = command.mode << 4 | tick & 0xF
        if not encode(command.force, last, self._command_form, self._command_range, data):
            raise self._unfit(command.force)
        sent = data.tobytes()
        start = 0
        frames = []
        for codec, _, _ in self._commands:
            end = start + codec.length
            frames.append(_new(Frame, (codec.id, sent[start:end], codec.flags)))
            start = end
        return dialogue, tuple(frames)

    def _unfit(self, force: Array) -> ProtocolError:
        codec = self._commands[0].codec
        return ProtocolError(
            f"force command {force.tolist()} N does not fit layout {self.layout}: {codec.low[0]:.12g} to "
            f"{codec.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return the frame that faults all drives at once."""
        return (Frame(self._estop.id, b"\0", self._estop.flags),)

    def decode(
        self, dialogue: Dialogue, run: bytes, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> Dialogue:
        """Fill the measurement of a tick from that of the last one and the frames since, joined by `run_of`.

        Every leg first ages by the ticks since the last one, up to NEVER. A feedback whose
        counter is this tick's has age 0, unless it came before `since_ns`: then it answers an older SYNC with
        the same four bits, and is refused. One whose counter lies d = 1..8 ticks back takes effect with age d
        if that is newer than what is held, else it is passed over; any other counter is refused. Refused as
        well, and counted in `rejected`: wrong length, CRC, state or fault, a value that is not finite.
        A feedback of this tick that calls its length invalid gives state and force alone: the leg ages, and
        is `blind`. Foreign frames are ignored. Fault comes from the status, state from the feedback. Layout
        classic carries no force: it stays as it was.
        """
        form, scale = self._feedback_form, self._feedback_range
        fold(run, since_ns, self._identifiers, form, scale, last, tick)
        return dialogue

    def fresh(self, received: Received, tick: int, _since_ns: int) -> bool:
        """Tell whether a frame is a feedback to this tick's SYNC by its counter."""
        identifier, data, flags = received.frame
        return (
            identifier in self.feedback_ids
            and not flags & FOREIGN
            and len(data) == self._feedback.length
            and (tick - data[self._counter_at]) & 0xF == 0
        )

    # drives' end

    def power_up(self) -> None:
        """Return None: nothing is remembered."""

    def parse(self, memory: Memory, frame: Frame) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end; no message for a frame that is not for them.

        An E-stop counts whatever its payload. Rejected: wrong length or CRC, unknown mode or
        reaction, a force that is not finite.
        """
        parser = self._parsers.get(frame.id)
        if parser is None or frame.flags & FOREIGN:
            return memory, ()
        return memory, (parser(frame.data),)

    def _parse_sync(self, data: bytes) -> DeviceMessage:
        if len(data) != self._sync.length:
            return Rejected(f"SYNC of {len(data)} bytes")
        return Sync(data[0])

    def _parse_command(self, command: _CommandFrame, data: bytes) -> DeviceMessage:
        codec, legs, register = command
        if len(data) != codec.length:
            return Rejected(f"command of {len(data)} bytes")
        force = np.empty(len(legs))
        last = decode_command(data, register, self._command_form, self._command_range, force)
        if last < 0:
            return Rejected(_UNTRUSTED[last])
        return _new(DeviceCommand, (legs, last >> 4, force, last & 0xF))

    def _parse_config(self, leg: int, register: int, data: bytes) -> DeviceMessage:
        codec = self._config
        if len(data) != codec.length or not intact(data, register):
            return Rejected("length or CRC of CONFIG")
        watchdog, reaction, slot = codec.unpack(data)
        if watchdog < 1 or reaction >= _REACTIONS or slot != leg + 1:
            return Rejected(f"CONFIG with watchdog {watchdog} us, reaction {reaction}, leg {slot}")
        return Configure(leg, watchdog * codec.scale[0], Reaction(reaction))

    def feedbacks(
        self, sync: Sync, length: Array, rate: Array, force: Array, state: Ints
    ) -> list[tuple[int, Frame]]:
        """Encode the six feedbacks to one SYNC, leg order; what exceeds its field saturates.

        length m, rate m/s, force N, each (6,); state (6,) DriveState, plus INVALID where length and rate are
        of no use; the counter's low four bits count. Raises ProtocolError on NaN.
        """
        data = np.empty(LEGS * self._feedback.length, np.uint8)
        leg = encode_feedbacks(
            length,
            rate,
            force,
            state,
            sync.counter & 0xF,
            self._identifiers,
            self._feedback_form,
            self._feedback_range,
            data,
        )
        if leg >= 0:
            raise ProtocolError(
                f"feedback of leg {leg} is not a number: {length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
            )
        flags = self._feedback.flags
        bodies = self._split(data.data)
        return [(leg, _new(Frame, (id_, bodies[leg], flags))) for leg, id_ in self._feedback_legs]

    def status(self, status: Status) -> tuple[Frame, ...]:
        """Encode one drive's heartbeat."""
        leg, state, fault = status
        return (Frame(self._status_id[leg], self._status.pack(state, fault), self._status.flags),)

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: SYNC, commands, six feedbacks."""
        zeros = np.zeros(LEGS)
        _, command = self.command(None, Command(DriveMode.OFF, zeros), 0)
        feedbacks = self.feedbacks(Sync(0), zeros, zeros, zeros, np.full(LEGS, DriveState.OFF, np.int64))
        return (*self.begin(None, 0), *command, *(frame for _, frame in feedbacks))
