"""The own protocol, compiled at start from legs.dbc into struct codecs and tables.

No state, no clock. Checks: `drivers.legs.crc`, over identifier (low byte, high byte), then the data before
the check. Fields are little-endian. `docs/guides/protocol.md` has the rules of both ends.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain
from typing import Any, NoReturn

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.compiled.pointed import data_at
from drivers.ends import Hearing
from drivers.errors import ConfigurationError, ProtocolError
from drivers.legs.codec import Place
from drivers.legs.controller import LegsController, LegsDialogue, codec_of, decoded, encoded
from drivers.legs.crc import crc8, identifier_state
from drivers.legs.device_kernels import NO_SYNC, intact
from drivers.legs.drives_end import LegsEnd
from drivers.legs.kernels import FOREIGN, QUANTITIES
from drivers.legs.messages import LAYOUTS, CommandFrame, read_messages, set_up_checksum
from drivers.legs.set_up import checksums_heard, lack
from drivers.legs.traits import Traits, checked_nodes
from drivers.protocol import (
    ALL_LEGS,
    ALWAYS,
    Configure,
    DeviceMessage,
    Dialogue,
    DriveSetup,
    EmergencyStop,
    Frame,
    Received,
    Rejected,
    Status,
    Sync,
)
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record

TRIES = 10
"""How often a drive that does not confirm its set-up is sent its CONFIG."""
SETUP_S = 0.02
"""From one CONFIG of a drive to its next."""
_ALL = (1 << LEGS) - 1
_POWERED = (DriveState.READY, DriveState.RUN)
_BYTES = [bytes([value]) for value in range(256)]
_new = tuple.__new__
"""Makes a NamedTuple of a tuple in half the time that its own constructor takes."""
_REACTIONS = len(Reaction)
_STATE_AT, _FAULT_AT, _SET_UP_AT = range(3)
"""Bytes of a status."""


class LegsProtocol(Traits):
    """The own protocol in one layout: `classic`, `fd` or `ideal`. Holds compiled tables only.

    `node_ids` are the drives' node numbers, leg order, 1..127, all different; `rated_force_N` is the unit of
    the forces where their fields are short. `slots`: place of each leg's force in the command; `places`: how
    many forces a command has room for, 3 or all. The drives' end remembers Cycle of the present SYNC. Raises
    ConfigurationError on other node numbers, an unknown layout or a rated force that does not fit.
    """

    command_delay_ticks = 0
    set_up_frames = 1
    reset_ticks = 5

    def __init__(
        self,
        layout: str,
        node_ids: Sequence[int],
        rated_force_N: float = 60_000.0,
        slots: Sequence[int] = ALL_LEGS,
        places: int = LEGS,
    ) -> None:
        if layout not in LAYOUTS:
            raise ConfigurationError(f"bus.layout: {layout!r} is unknown, allowed are {', '.join(LAYOUTS)}")
        nodes = checked_nodes(node_ids)
        self.layout = layout
        self.node_ids = nodes
        self.rated_force_N = rated_force_N
        self._slots = tuple(slots)
        messages = read_messages(layout, rated_force_N, places)
        self.database = "legs.dbc", messages.text
        self._version = messages.version
        self._estop, self._sync = messages.estop, messages.sync
        self._config, self._status = messages.config, messages.status
        self._feedback, self._commands = messages.feedback, messages.commands
        self._has_force = "Force" in self._feedback.signals
        self._exact = self._feedback.exact
        feedback_id = [self._feedback.id - 1 + node for node in nodes]
        self.feedback_by_leg = tuple(feedback_id)
        """Identifiers of the feedbacks, leg order."""
        self.feedback_ids = frozenset(feedback_id)
        self._counter_at = self._feedback.place("Counter").start // 8
        # Per leg: identifier, CRC register after it.
        self._feedback_key = [(identifier, identifier_state(identifier)) for identifier in feedback_id]
        self._feedback_register = dict(self._feedback_key)
        self._status_id = [self._status.id - 1 + node for node in nodes]
        self._config_id = [self._config.id - 1 + node for node in nodes]
        self._configured = {identifier: leg for leg, identifier in enumerate(self._config_id)}
        self.senders = {
            identifier: leg for ids in (feedback_id, self._status_id) for leg, identifier in enumerate(ids)
        }
        self._sync_register = identifier_state(self._sync.id)
        self._syncs = [
            (Frame(self._sync.id, cycle + _BYTES[crc8(cycle, self._sync_register)], self._sync.flags),)
            for cycle in _BYTES
        ]
        self._tabulate(messages.command_ids)
        # Device side: identifier -> parser of what is not compiled.
        self._parsers: dict[int, Callable[[bytes], DeviceMessage]] = {
            self._estop.id: lambda _data: EmergencyStop(),
            **{
                identifier: partial(self._parse_config, leg, identifier_state(identifier))
                for leg, identifier in enumerate(self._config_id)
            },
        }
        self._end = LegsEnd([self])

    def _tabulate(self, command_ids: Sequence[int]) -> None:
        """Make the tables of `drivers.legs.kernels` and `drivers.legs.device_kernels`."""
        feedback, command = self._feedback, self._commands[0].layout
        ids, registers = zip(*self._feedback_key, strict=True)
        others = [self._estop.id, self._sync.id, *self._config_id, *command_ids]
        status = [*self._status_id, *map(identifier_state, self._status_id)]
        self._identifiers = np.array([*ids, *registers, *status, *others], np.int64)
        at = [_STATE_AT, _FAULT_AT, _SET_UP_AT, self._counter_at]
        places = [*feedback.places[: 3 if self._has_force else 2], Place(0, 0, is_float=False)]
        self._feedback_form = np.array(
            [feedback.length, self._status.length, *at, self._exact, *chain(*places[:QUANTITIES])], np.int64
        )
        self._feedback_range = np.array([*feedback.scale[:3], *feedback.low[:3], *feedback.high])
        force, counter, mode, check = (
            command.place(name) for name in (command.signals[0], "Counter", "Mode", "CRC")
        )
        self._counter_mask = (1 << counter.size) - 1
        frames = [(frame.layout.length, frame.register) for frame in self._commands]
        forces = len(self._commands[0].legs)
        fields = [*force, *counter[:2], *mode[:2], check.start // 8, check.size // 8, forces]
        self._command_form = np.array([*fields, *chain(*frames)], np.int64)
        self._command_fields = fields
        steps = 1 << force.size - 1
        ends = (command.low[0], command.high[0]) if self._exact else (-steps, steps - 1)
        self._command_range = np.array([command.scale[0], *ends], float)
        self._codec, self._codec_keeps = self.codec(self.command_rows(range(LEGS), 0))

    @property
    def commands(self) -> tuple[Ints, Array, int, tuple[CommandFrame, ...]]:
        """Form and range of the commands, the bits of a Cycle that they carry, and the frames."""
        return self._command_form, self._command_range, self._counter_mask, self._commands

    def fill_end(self, end: Any) -> None:
        """Fill in what all buses have in common; see `drivers.legs.device_kernels.END`."""
        for name, table in (
            ("identifiers", self._identifiers),
            ("form", self._feedback_form),
            ("scale", self._feedback_range),
        ):
            end[name] = data_at(table)
        end["sync_id"], end["sync_size"] = self._sync.id, self._sync.length
        end["sync_register"], end["feedback_flags"] = self._sync_register, self._feedback.flags
        end["estop_id"], end["status_flags"] = self._estop.id, self._status.flags
        end["counter_at"], end["version"] = self._counter_at, self._version
        end["rated_mN"], end["watchdog_s"] = round(self.rated_force_N * 1e3), self._config.scale[0]
        end["config_id"], end["slot"] = self._config_id, self._slots

    def command_rows(self, legs: Sequence[int], bus: int) -> list[tuple[list[int], Array]]:
        """Return the form of each command frame (`kernels.COMMAND_FORM`) with step and ends of its forces.

        legs: those of the places, in their order; on a bus of several.
        """
        rows = []
        for n, (of, places, register) in enumerate(self._commands):
            first = n * len(places)
            own = [*legs[first : first + len(places)], *[-1] * LEGS][:LEGS]
            frame = [of.id, of.flags, bus, of.length, register, *own]
            rows.append(([*self._command_fields, *frame], self._command_range))
        return rows

    def codec(
        self, rows: Sequence[tuple[list[int], Array]], buses: int = 1, bus_of: Sequence[int] = (0,) * LEGS
    ) -> tuple[Record, Any]:
        """Return a record of `kernels.CODEC` for so many buses, and the arrays that it points to."""
        tables = self._identifiers, self._feedback_form, self._feedback_range[: 3 * QUANTITIES]
        return codec_of(tables, rows, buses, bus_of)

    # controller side

    def controller_end(self, setup: DriveSetup) -> LegsController:
        """Return the controller's end, compiled."""
        return LegsController(self, setup, self._codec, self._syncs)

    def start(self, setup: DriveSetup) -> LegsDialogue:
        """Return the dialogue before the first CONFIG. Raises ProtocolError as `configure` does."""
        frames = self.configure(setup.watchdog_s, setup.reaction)
        sums = [set_up_checksum(frame.id, frame.data[:-1], self.rated_force_N) for frame in frames]
        expected = b"".join(each.to_bytes(2, "little") for each in sums)
        return LegsDialogue(frames, expected, max(LEGS, round(SETUP_S * setup.rate_Hz)), (0,) * LEGS)

    def begin(self, _dialogue: Dialogue, tick: int) -> tuple[Frame, ...]:
        """Return the SYNC frame: the tick modulo 256."""
        return self._syncs[tick & 0xFF]

    def set_up(self, dialogue: LegsDialogue, tick: Record) -> tuple[LegsDialogue, tuple[Frame, ...]]:
        """Return the CONFIG of a drive that is heard and has none from us or does not confirm it, one a tick.

        A drive that is out of boot gets it TRIES times at most.
        """
        leg = int(tick["tick"]) % dialogue.interval
        if leg >= LEGS or tick["age"][leg] > 1:
            return dialogue, ()
        state, sent = tick["drive_state"][leg], dialogue.sent
        enough = sent[leg] >= (1 if dialogue.confirmed >> leg & 1 else TRIES)
        if state != DriveState.BOOT and (enough or state in _POWERED):
            return dialogue, ()
        sent = (*sent[:leg], sent[leg] + 1, *sent[leg + 1 :])
        return dialogue._replace(sent=sent), (dialogue.configure[leg],)

    def legs_set_up(self, dialogue: LegsDialogue) -> tuple[bool, ...]:
        """Tell which drives have been sent their CONFIG and have confirmed it."""
        return tuple([n > 0 and dialogue.confirmed >> leg & 1 == 1 for leg, n in enumerate(dialogue.sent)])

    def set_up_lacks(self, dialogue: LegsDialogue) -> tuple[str, ...]:
        """Return what the checksums say that differ, see `drivers.legs.set_up`."""
        done, (sent, said) = self.legs_set_up(dialogue), (dialogue.sent, dialogue.said)
        frames, config, rated = dialogue.configure, self._config, self.rated_force_N
        return tuple(
            "" if done[leg] else lack(said[leg], sent[leg], frames[leg], config, rated) for leg in range(LEGS)
        )

    def configure(self, watchdog_s: float, reaction: Reaction) -> tuple[Frame, ...]:
        """Return the six CONFIG frames. Raises ProtocolError if the watchdog is not 1 us .. 4294 s."""
        frames = []
        for leg, identifier in enumerate(self._config_id):
            body = self._config_body(leg, watchdog_s, reaction)
            check = crc8(body, identifier_state(identifier))
            frames.append(Frame(identifier, body + _BYTES[check], self._config.flags))
        return tuple(frames)

    def _config_body(self, leg: int, watchdog_s: float, reaction: Reaction) -> bytes:
        """Return a CONFIG without its CRC. Raises ProtocolError if the watchdog does not fit."""
        codec = self._config
        try:
            watchdog = round(watchdog_s / codec.scale[0])
            body = codec.pack(watchdog, int(reaction), self._slots[leg] + 1, self._version)
        except (struct.error, ValueError, OverflowError):
            watchdog = 0
        if watchdog < 1:
            raise ProtocolError(
                f"drive watchdog of {watchdog_s} s does not fit into CONFIG: "
                "0.000001 to 4294.967295 s are allowed"
            )
        return body

    def command(self, dialogue: Dialogue, command: Command, tick: int) -> tuple[Dialogue, tuple[Frame, ...]]:
        """Return one tick's command frames.

        force (6,) N, > 0 extends; the counter is that of the tick's SYNC.
        Raises ProtocolError if a force is not finite or does not fit the layout's field.
        """
        return dialogue, encoded(self._codec, command, tick) or self._refuse(command.force)

    def _refuse(self, force: Array) -> NoReturn:
        raise self._unfit(force)

    def _unfit(self, force: Array) -> ProtocolError:
        of = self._commands[0].layout
        return ProtocolError(
            f"force command {force.tolist()} N does not fit layout {self.layout}: {of.low[0]:.12g} to "
            f"{of.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return the frame that faults all drives at once."""
        return (Frame(self._estop.id, b"\0", self._estop.flags),)

    def decode(
        self, dialogue: LegsDialogue, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> LegsDialogue:
        """Fill the measurement of a tick from that of the last one and the frames since, elements of FRAME.

        Every leg first ages by the ticks since the last one, up to NEVER. A feedback whose
        counter is this tick's has age 0, unless it came before `since_ns`: then it answers an older SYNC with
        the same four bits, and is refused. One whose counter lies d = 1..8 ticks back takes effect with age d
        if that is newer than what is held, else it is passed over; any other counter is refused. Refused as
        well, and counted in `rejected`: wrong length, CRC, state or fault, a value that is not finite.
        A feedback of this tick that calls its length invalid gives state and force alone: the leg ages, and
        is `blind`. A second answer to the SYNC of what is held that says something else makes the node
        `doubled`; the first one counts. SYNC, command, CONFIG and E-stop are `foreign`, whatever they carry:
        nobody hears what he sends himself. Other frames are ignored. Fault and set-up come from the status,
        state from the feedback. Layout classic carries no force: it stays as it was.
        """
        return decoded(self._codec, dialogue, frames, last, tick, since_ns, self.heard)

    def heard(self, said: tuple[int, ...], frames: Rows) -> tuple[int, ...]:
        """Return what the drives have said of their set-up, with the statuses of a tick."""
        return checksums_heard(said, frames, self._status_id, self._status.length, _SET_UP_AT)

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is an intact feedback to this tick's SYNC."""
        t_ns, (identifier, data, flags) = received
        return (
            identifier in self.feedback_ids
            and not flags & FOREIGN
            and len(data) == self._feedback.length
            and (tick - data[self._counter_at]) & 0xF == 0
            and t_ns >= since_ns
            and intact(data, self._feedback_register[identifier])
        )

    # drives' end

    def power_up(self) -> int:
        """Return NO_SYNC: no SYNC is present."""
        return NO_SYNC

    def parse(self, memory: int, frame: Frame) -> tuple[int, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end; no message for a frame that is not for them.

        An E-stop counts whatever its payload. Rejected: wrong length or check, unknown mode or reaction, a
        force that is not finite, a command that is not for the present SYNC, a SYNC that repeats the present
        one, a CONFIG of another version of the protocol.
        """
        if frame.flags & FOREIGN:
            return memory, ()
        parser = self._parsers.get(frame.id)
        if parser is not None:
            return memory, (parser(frame.data),)
        end = self._end
        end.memory = memory
        messages = end.messages(frame)
        return end.memory, messages or ()

    def drives_end(self) -> LegsEnd | None:
        """Return the drives' end by address, powered up; None for a protocol that changes it."""
        return LegsEnd([self]) if type(self) is LegsProtocol else None

    def hearing(self) -> Hearing | None:
        """Return the controller's end by address, as far as it hears; None as `drives_end`."""
        return self._end.hearing(self.feedback_by_leg) if type(self) is LegsProtocol else None

    def _parse_config(self, leg: int, register: int, data: bytes) -> DeviceMessage:
        codec = self._config
        if len(data) != codec.length or not intact(data, register):
            return Rejected("length or CRC of CONFIG")
        watchdog, reaction, slot, version = codec.unpack(data)
        if version != self._version:
            return Rejected(f"CONFIG of version {version} of the protocol, this drive has {self._version}")
        if watchdog < 1 or reaction >= _REACTIONS or slot != self._slots[leg] + 1:
            return Rejected(f"CONFIG with watchdog {watchdog} us, reaction {reaction}, leg {slot}")
        return Configure(leg, watchdog * codec.scale[0], Reaction(reaction))

    def answer(
        self,
        memory: int,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        _fault: Ints | None = None,
    ) -> tuple[int, list[tuple[int, Frame]]]:
        """Encode the six feedbacks to one SYNC, leg order; what exceeds its field saturates.

        length m, rate m/s, force N, each (6,); state (6,) DriveState, plus INVALID where length and rate are
        of no use; the counter's low four bits count. Raises ProtocolError on NaN.
        """
        frames = self._end.answers(sync, length, rate, force, state)
        if frames is None:
            unknown = np.isnan(length) | np.isnan(rate) | (np.isnan(force) & self._has_force)
            leg = int(np.flatnonzero(unknown)[0])
            raise ProtocolError(
                f"feedback of leg {leg} is not a number: {length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
            )
        return memory, frames

    def report(self, memory: int, status: Status) -> tuple[int, tuple[Frame, ...]]:
        """Encode one drive's heartbeat."""
        frames = self._end.reports(status)
        if frames is None:
            assert status.set_up is not None
            self._config_body(status.leg, status.set_up.watchdog_s, status.set_up.reaction)
        return memory, frames or ()

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: SYNC, commands, six feedbacks."""
        zeros = np.zeros(LEGS)
        _, command = self.command(None, Command(DriveMode.OFF, zeros), 0)
        off = np.full(LEGS, DriveState.OFF, np.int64)
        _, feedbacks = self.answer(NO_SYNC, Sync(0), zeros, zeros, zeros, off)
        return (*self.begin(None, 0), *command, *(frame for _, frame in feedbacks))
