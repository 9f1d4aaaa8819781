"""A drive family for tests that shares only the contract with the real families.

29-bit identifiers, one per kind and node. Three exchanges set a node up. There is no SYNC and no counter: a
drive answers its poll in two frames, and the poll carries the command of the last tick. Heartbeats carry the
drives' own fault codes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cached_property
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows, array_at
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import FAILED, Pointed, of_python
from drivers.config import BusSettings, DriveSettings
from drivers.controller_end import ControllerEnd
from drivers.errors import ConfigurationError, ProtocolError
from drivers.family import Family
from drivers.frame_array import FRAME, NO_FRAMES, received_frames, sent_array
from drivers.protocol import ERROR, EXTENDED, REMOTE, SINGLE, DriveSetup, Frame, Resolution, Traits
from drivers.signals import INVALID, LEGS, NEVER, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, tick_at
from plant_fmu.drives import codec
from plant_fmu.drives.codec import MESSAGE, READING, DrivesEnd

STOP, POLL, PLACE, LOAD, SET, DONE, BEAT = range(7)
"""Kinds of frames, in the order of arbitration."""
BASE = 0x0A00_0000
MAX_NODE = 0xFFFF
EXCHANGES = 3
MAGIC = 0x5E7
RETRY = 10
"""Ticks after which a request without an answer is repeated."""
OWN_FAULTS = 0x7300
"""Offset from a DriveFault to the drives' own code."""
_FIELDS = {
    STOP: struct.Struct("<"),
    POLL: struct.Struct("<Bf"),
    PLACE: struct.Struct("<ii"),
    LOAD: struct.Struct("<fB"),
    SET: struct.Struct("<BI"),
    DONE: struct.Struct("<B"),
    BEAT: struct.Struct("<BH"),
}
_STEP_m = 1e-7
MOST_SET_UP = 2
"""Most frames of the set-up in a tick."""


class StubDialogue(NamedTuple):
    """State of the controller: values of the exchanges, those confirmed, ticks of requests, the next polls."""

    values: tuple[int, ...]
    done: tuple[int, ...]
    asked: tuple[int, ...]
    polls: tuple[Frame, ...]


class StubMemory(NamedTuple):
    """State of the drives, one element per drive; `polls` counts polls received, none of them a repetition."""

    done: tuple[int, ...]
    watchdog_us: tuple[int, ...]
    polls: tuple[int, ...]


def _put(values: tuple[int, ...], leg: int, value: int) -> tuple[int, ...]:
    return (*values[:leg], value, *values[leg + 1 :])


class InPython(Pointed):
    """A function of integers that compiled passes call by its address. It must not raise."""

    def __init__(self, function: Callable[..., int], arguments: int) -> None:
        address, self.keeps = of_python(function, *[INTEGER] * arguments)
        super().__init__(address, ("", b""), function)


UNUSED = np.dtype([("unused", "<i8")])
"""An unused record: the stub has its state in Python."""


class StubProtocol(Family):
    def __init__(self, node_ids: list[int]) -> None:
        super().__init__(node_ids)
        self.refuse_nodes(0, MAX_NODE, "the stub")
        self._id = {
            (kind, leg): BASE | kind << 16 | node for kind in _FIELDS for leg, node in enumerate(node_ids)
        }
        self._meaning = {identifier: key for key, identifier in self._id.items()}
        self.tables = np.zeros((), UNUSED)
        self.wanted = tuple(self._id[kind, leg] for kind in (PLACE, LOAD) for leg in range(LEGS))
        self.fresh_by, self.addressed_by = InPython(self._fresh, 4), InPython(self._addressed, 2)

    @cached_property
    def traits(self) -> Traits:
        return Traits(
            family="stub",
            resolution=Resolution.of(_STEP_m, _STEP_m, SINGLE),
            sent=self.polls(DriveMode.OFF, (0.0,) * LEGS),
            feedbacks=tuple(frame for leg in range(LEGS) for frame in self.feedback(leg, 0.0, 0.0, 0.0, 0)),
            emergency_stop=tuple(self.frame(STOP, leg) for leg in range(LEGS)),
            feedback_ids=frozenset(self.wanted),
            database=("stub.dbc", 'VERSION ""\n'),
            command_delay_ticks=1,
            set_up_frames=MOST_SET_UP,
            reset_ticks=2,
            stop_latches=True,
            force_on_brakes=True,
            reactions=tuple(Reaction),
        )

    def controller_end(self, setup: DriveSetup) -> StubController:
        return StubController(self, setup)

    def drives_end(self) -> StubDrives:
        return StubDrives(self)

    def frame(self, kind: int, leg: int, *values: float) -> Frame:
        return Frame(self._id[kind, leg], _FIELDS[kind].pack(*values), EXTENDED)

    def feedback(self, leg: int, length: float, rate: float, force: float, state: int) -> tuple[Frame, Frame]:
        """Frames of a drive's answer: length and rate, then force and state."""
        steps = [round(float(np.clip(v / _STEP_m, -(1 << 31), (1 << 31) - 1))) for v in (length, rate)]
        return self.frame(PLACE, leg, *steps), self.frame(LOAD, leg, float(np.clip(force, -1e9, 1e9)), state)

    def read(self, frame: Frame) -> tuple[int, int, tuple[float, ...] | None] | None:
        """Kind, leg and fields; fields None for a wrong length, all None for a foreign frame."""
        if not frame.flags & EXTENDED or frame.flags & (REMOTE | ERROR | 0xFF00):
            return None
        if frame.id not in self._meaning:
            return None
        kind, leg = self._meaning[frame.id]
        fields = _FIELDS[kind]
        return kind, leg, fields.unpack(frame.data) if len(frame.data) == fields.size else None

    def _addressed(self, _tables: int, frame: int) -> int:
        return 1 << self._meaning[int(array_at(frame, 1, FRAME)["id"][0])][1]

    def sender(self, frame: Frame) -> int:
        read = self.read(frame)
        return read[1] if read is not None and read[0] in (PLACE, LOAD, DONE, BEAT) else -1

    def polls(self, mode: int, force: tuple[float, ...]) -> tuple[Frame, ...]:
        return tuple(self.frame(POLL, leg, mode, f) for leg, f in enumerate(force))

    def _fresh(self, _tables: int, frame: int, _tick: int, since_ns: int) -> int:
        ((t_ns, received),) = received_frames(array_at(frame, 1, FRAME))
        read = self.read(received)
        fresh = read is not None and read[0] in (PLACE, LOAD) and t_ns >= since_ns
        return self.wanted.index(received.id) + 1 if fresh else 0

    def fault_text(self, code: int) -> str:
        return f"code {code - OWN_FAULTS} of the stub" if code >= OWN_FAULTS else ""


class StubController(ControllerEnd):
    """The controller's end, in Python. Mutable state: the dialogue."""

    def __init__(self, protocol: StubProtocol, setup: DriveSetup) -> None:
        self._protocol, self._setup = protocol, setup
        functions = InPython(self._decode, 6), InPython(self._command, 6), InPython(self._begin, 3)
        super().__init__(np.zeros((), UNUSED), *functions)
        self.start()

    def start(self) -> None:
        watchdog_us, nothing = self._setup.watchdog_s * 1e6, (0,) * LEGS
        if not 1 <= watchdog_us < 1 << 32:
            raise ProtocolError(f"drive watchdog of {self._setup.watchdog_s} s")
        values = (MAGIC, round(watchdog_us), int(self._setup.reaction))
        polls = self._protocol.polls(DriveMode.OFF, nothing)
        self.dialogue = StubDialogue(values, nothing, (-RETRY,) * LEGS, polls)

    def _begin(self, _opener: int, _number: int, into: int) -> int:
        array_at(into, LEGS, FRAME)[:] = sent_array(self.dialogue.polls)
        return LEGS

    def _put(self, leg: int, done: int, asked: int) -> None:
        d = self.dialogue
        self.dialogue = d._replace(done=_put(d.done, leg, done), asked=_put(d.asked, leg, asked))

    def _decode(
        self, _codec: int, at: int, count: int, since_ns: int, last_at: int, tick_address: int
    ) -> int:
        protocol, before = self._protocol, self.legs_set_up()
        last, tick = tick_at(last_at), tick_at(tick_address)
        place: dict[int, tuple[float, ...]] = {}
        load: dict[int, tuple[float, ...]] = {}
        number, previous, rejected = int(tick["tick"]), int(last["tick"]), 0
        for name in ("length", "rate", "drive_force", "drive_state", "drive_fault"):
            tick[name] = last[name]
        for received in received_frames(array_at(at, count, FRAME) if count else NO_FRAMES):
            read = protocol.read(received.frame)
            if read is None:
                continue
            kind, leg, fields = read
            if fields is None or (kind == LOAD and int(fields[1]) & ~INVALID >= len(DriveState)):
                rejected += 1
            elif kind in (PLACE, LOAD) and protocol.fresh(received, number, since_ns):
                (place if kind == PLACE else load)[leg] = fields
            elif kind == DONE and fields[0] == self.dialogue.done[leg]:
                self._put(leg, int(fields[0]) + 1, -RETRY)
            elif kind == BEAT:
                tick["drive_fault"][leg] = fields[1]
        tick["age"] = np.minimum(last["age"] + (number - previous if previous >= 0 else 1), NEVER)
        tick["blind"] = 0
        for leg in place.keys() & load.keys():
            said = int(load[leg][1])
            tick["drive_force"][leg], tick["drive_state"][leg] = load[leg][0], said & ~INVALID
            tick["blind"][leg] = bool(said & INVALID)
            if not tick["blind"][leg]:
                tick["length"][leg], tick["rate"][leg] = (value * _STEP_m for value in place[leg])
                tick["age"][leg] = 0
        tick["counted_age"], tick["rejected"] = tick["age"], rejected
        return int(self.legs_set_up() != before)

    def _command(self, _codec: int, _number: int, mode: int, _stop: int, force_at: int, _into: int) -> int:
        force = tuple(array_at(force_at, LEGS, np.float64).tolist())
        if not all(isfinite(f) and abs(f) < 1e9 for f in force):
            return FAILED
        self.dialogue = self.dialogue._replace(polls=self._protocol.polls(mode, force))
        return 0

    def set_up(self, tick: Record) -> Rows:
        frames: list[Frame] = []
        number = int(tick["tick"])
        for leg in range(LEGS):
            state, waited = tick["drive_state"][leg], number - self.dialogue.asked[leg]
            if tick["age"][leg] > 1 or waited < RETRY or state in (DriveState.READY, DriveState.RUN):
                continue
            done = self.dialogue.done[leg]
            if done == EXCHANGES:
                if state != DriveState.BOOT or tick["age"][leg]:
                    continue
                done = 0  # it has lost its set-up
            if len(frames) == MOST_SET_UP:
                break
            frames.append(self._protocol.frame(SET, leg, done, self.dialogue.values[done]))
            self._put(leg, done, number)
        return sent_array(frames)

    def lack(self, leg: int) -> str:
        done = self.dialogue.done[leg]
        return "" if done == EXCHANGES else f"exchange {done} of {EXCHANGES} is not confirmed"

    def unfit(self, force: Array) -> ProtocolError:
        return ProtocolError(f"force command {force.tolist()}: six of less than 1e9 N are allowed")

    def remembered(self) -> Any:
        return self.dialogue

    def remember(self, dialogue: Any) -> None:
        self.dialogue = dialogue


class StubDrives(DrivesEnd):
    """The drives' end, in plain Python. Mutable state: the memory."""

    def __init__(self, protocol: StubProtocol) -> None:
        self._protocol, self.memory = protocol, StubMemory(*[(0,) * LEGS] * 3)
        functions = InPython(lambda *_: FAILED, 3), InPython(self._answers, 5), InPython(self._reports, 8)
        super().__init__(np.zeros(1, FRAME), *functions)

    def converse(self, frame: Frame) -> None:
        read = self._protocol.read(frame)
        if read is None or read[0] not in (STOP, POLL, SET):
            return
        kind, leg, fields = read
        if fields is None:
            self.put(codec.REJECTED)
        elif kind == STOP:
            self.put(codec.STOP, (leg,))
        elif kind == POLL:
            self._on_poll(leg, int(fields[0]), fields[1])
        else:
            self._on_set(leg, int(fields[0]), int(fields[1]))

    def _on_poll(self, leg: int, mode: int, force: float) -> None:
        if mode >= len(DriveMode) or not isfinite(force):
            self.put(codec.REJECTED)
            return
        count = self.memory.polls[leg] + 1
        self.memory = self.memory._replace(polls=_put(self.memory.polls, leg, count))
        self.put(codec.COMMAND, (leg,), mode, count, force)
        self.put(codec.SYNC, (leg,))

    def _on_set(self, leg: int, step: int, value: int) -> None:
        memory, fits = self.memory, (value == MAGIC, value > 0, value < len(Reaction))
        if step >= EXCHANGES or step > memory.done[leg] or not fits[step]:
            self.put(codec.REJECTED)
            return
        memory = memory._replace(done=_put(memory.done, leg, step + 1))
        if step == 1:
            memory = memory._replace(watchdog_us=_put(memory.watchdog_us, leg, value))
        if step == EXCHANGES - 1:
            self.put(codec.CONFIGURE, (leg,), value, 1000 * memory.watchdog_us[leg])
        self.memory = memory
        self.say(leg, self._protocol.frame(DONE, leg, step))

    def _answers(self, _context: int, asked_at: int, reading_at: int, into: int, legs_at: int) -> int:
        (asked,), (reading,) = array_at(asked_at, 1, MESSAGE), array_at(reading_at, 1, READING)
        legs = asked["legs"][: asked["count"]].tolist()
        frames: list[Frame] = []
        for leg in legs:
            length, rate, force = (float(reading[name][leg]) for name in ("length", "rate", "force"))
            if np.isnan((length, rate, force)).any():
                return FAILED
            frames += self._protocol.feedback(leg, length, rate, force, int(reading["state"][leg]))
        array_at(into, len(frames), FRAME)[:] = sent_array(frames)
        array_at(legs_at, len(frames), np.int64)[:] = np.repeat(legs, 2)
        return len(frames)

    def _reports(self, _context: int, leg: int, state: int, fault: int, *rest: int) -> int:
        frame = self._protocol.frame(BEAT, leg, state, OWN_FAULTS + fault if fault else 0)
        array_at(rest[-1], 1, FRAME)[:] = sent_array([frame])
        return 1


def stub(bus: BusSettings, drives: DriveSettings) -> StubProtocol:
    """Codec of a configuration: the entry point of the stub."""
    if bus.layout == "ideal":
        raise ConfigurationError("bus.layout: allowed with the stub: classic, fd, given: ideal")
    if drives.options:
        raise ConfigurationError(f"drives.options: the stub has none, given: {', '.join(drives.options)}")
    return StubProtocol(drives.node_ids)
