"""A drive family whose drives are on several buses: each frame to and from the bus of its drive.

The controller's end keeps one dialogue: what it sends goes out on the bus of the leg that it is for, what is
for all on every bus, in the order of the buses. A drive's frame counts on its own bus only. At the drives'
end the drives of each bus have a memory of their own, for they hear that bus alone.
"""

from collections.abc import Sequence
from typing import cast

from drivers.arrays import Array, Ints, Rows
from drivers.controller_end import ControllerEnd
from drivers.ends import DrivesEnd, Hearing
from drivers.frame_array import received_array, received_frames
from drivers.identity import Identified, Said
from drivers.protocol import (
    ALWAYS,
    BUS,
    Alive,
    Answer,
    Configure,
    DeviceCommand,
    DeviceMessage,
    Dialogue,
    DriveProtocol,
    DriveSetup,
    EmergencyStop,
    Frame,
    Memory,
    PowerTold,
    Received,
    Status,
    Sync,
)
from drivers.resolution import Resolution
from drivers.signals import LEGS, Command, Reaction
from drivers.tick_columns import Record

Memories = tuple[Memory, ...]
"""What the drives of each bus remember."""


def on_bus(frame: Frame, bus: int) -> Frame:
    """Return a frame of bus 0 on another one."""
    return frame._replace(flags=frame.flags + BUS * bus) if bus else frame


def off_bus(frame: Frame) -> Frame:
    """Return a frame as the family knows it, which has one bus."""
    return frame._replace(flags=frame.flags % BUS) if frame.flags >= BUS else frame


class SeveralBuses:
    """A `DriveProtocol` on several buses, made from the same one on a single bus. Holds tables only."""

    def __init__(self, family: DriveProtocol, legs: Sequence[Sequence[int]]) -> None:
        """Take the family and the legs of each bus, which together are all legs, each once."""
        self.family = family
        self.legs = tuple(map(tuple, legs))
        self.bus_of = tuple(
            next(bus for bus, there in enumerate(self.legs) if leg in there) for leg in range(LEGS)
        )
        self._buses = tuple(range(len(self.legs)))

    # what the family says of itself

    @property
    def database(self) -> tuple[str, str] | None:
        """As the family's."""
        return self.family.database

    @property
    def feedback_ids(self) -> frozenset[int]:
        """As the family's."""
        return self.family.feedback_ids

    @property
    def shares_identifiers(self) -> bool:
        """As the family's."""
        return self.family.shares_identifiers

    @property
    def command_delay_ticks(self) -> int:
        """As the family's."""
        return self.family.command_delay_ticks

    @property
    def set_up_frames(self) -> int:
        """As the family's."""
        return self.family.set_up_frames

    @property
    def reset_ticks(self) -> int:
        """As the family's."""
        return self.family.reset_ticks

    @property
    def reactions(self) -> tuple[Reaction, ...]:
        """As the family's."""
        return self.family.reactions

    @property
    def dangers(self) -> tuple[str, ...]:
        """As the family's."""
        return self.family.dangers

    @property
    def answers_name_sync(self) -> bool:
        """As the family's."""
        return self.family.answers_name_sync

    @property
    def latches_together(self) -> bool:
        """As the family's."""
        return self.family.latches_together

    @property
    def unasked_s(self) -> float:
        """As the family's."""
        return self.family.unasked_s

    def resolution(self, rate_Hz: float) -> Resolution:
        """As the family's."""
        return self.family.resolution(rate_Hz)

    @property
    def force_on_brakes(self) -> bool:
        """See `DriveProtocol.force_on_brakes`."""
        return self.family.force_on_brakes

    @property
    def has_watchdog(self) -> bool:
        """As the family's."""
        return self.family.has_watchdog

    @property
    def power_told(self) -> PowerTold:
        """As the family's."""
        return self.family.power_told

    @property
    def stop_latches(self) -> bool:
        """As the family's."""
        return self.family.stop_latches

    def reported_lengths(self) -> tuple[Array, Array] | None:
        """As the family's."""
        return self.family.reported_lengths()

    def carried(self, dialogue: Dialogue, force: Array) -> Array:
        """As the family's."""
        return self.family.carried(dialogue, force)

    def fault_text(self, code: int) -> str:
        """As the family's."""
        return self.family.fault_text(code)

    def legs_set_up(self, dialogue: Dialogue) -> tuple[bool, ...]:
        """As the family's."""
        return self.family.legs_set_up(dialogue)

    def set_up_lacks(self, dialogue: Dialogue) -> tuple[str, ...]:
        """As the family's."""
        return self.family.set_up_lacks(dialogue)

    # controller's end

    def start(self, setup: DriveSetup) -> Dialogue:
        """Return the dialogue before its first frame. Raises ProtocolError if the set-up does not fit."""
        return self.family.start(setup)

    def controller_end(self, setup: DriveSetup) -> ControllerEnd:
        """Return the controller's end, compiled where the family's is."""
        make = getattr(self.family, "controller_end", None)
        end: ControllerEnd = ControllerEnd(self, setup) if make is None else make(setup, self)
        return end

    def begin(self, dialogue: Dialogue, tick: int) -> tuple[Frame, ...]:
        """Frames that start a tick: SYNC on every bus, or each drive's poll on its own."""
        return self.spread(self.family.begin(dialogue, tick))

    def command(self, dialogue: Dialogue, command: Command, tick: int) -> tuple[Dialogue, tuple[Frame, ...]]:
        """Frames of one tick's command. Raises ProtocolError if a force does not fit."""
        dialogue, frames = self.family.command(dialogue, command, tick)
        return dialogue, self.spread(frames)

    def set_up(self, dialogue: Dialogue, tick: Record) -> tuple[Dialogue, tuple[Frame, ...]]:
        """Frames of the start-up dialogue of this tick."""
        dialogue, frames = self.family.set_up(dialogue, tick)
        return dialogue, self.spread(frames)

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Frames that fault all drives at once."""
        return self.spread(self.family.emergency_stop())

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        """Those of the family, each on the bus of its leg; none where it has none."""
        family = self.family
        if not isinstance(family, Identified):
            return ()
        return tuple(self.spread(frames) for frames in family.identity_requests())

    def identity(self, frame: Frame) -> Said | None:
        """Return what a frame says of who sends it on its own bus."""
        said = self.family.identity(off_bus(frame)) if isinstance(self.family, Identified) else None
        return said if said is not None and self.bus_of[said.leg] == frame.bus else None

    def spread(self, frames: Sequence[Frame]) -> tuple[Frame, ...]:
        """Put each frame on the buses of the legs that it is for."""
        addressed, bus_of = self.family.addressed, self.bus_of
        sent = []
        for frame in frames:
            legs = addressed(frame)
            if len(legs) == 1:
                sent.append(on_bus(frame, bus_of[legs[0]]))
            else:
                sent += [on_bus(frame, bus) for bus in sorted({bus_of[leg] for leg in legs})]
        return tuple(sent)

    def _strays(self, frame: Frame, known: Frame) -> bool:
        """Tell whether a drive's frame comes on another bus than its own."""
        leg = self.family.sender(known)
        return leg >= 0 and self.bus_of[leg] != frame.bus

    def decode(
        self, dialogue: Dialogue, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> Dialogue:
        """Fill the measurement of a tick; see `DriveProtocol.decode`.

        A frame of a drive that comes on another bus than its own is refused, and counted in `rejected`.
        """
        kept, strays = [], 0
        for t_ns, frame in received_frames(frames):
            known = off_bus(frame)
            if self._strays(frame, known) or frame.bus >= len(self.legs):
                strays += 1
            else:
                kept.append(Received(t_ns, known))
        dialogue = self.family.decode(dialogue, received_array(kept), last, tick, since_ns)
        tick["rejected"] += strays
        return dialogue

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is feedback of this tick on its drive's own bus that can be trusted."""
        known = off_bus(received.frame)
        return not self._strays(received.frame, known) and self.family.fresh(
            Received(received.t_ns, known), tick, since_ns
        )

    def awaited(self, frame: Frame) -> int:
        """Return which of `feedback_ids` a frame is; another number for what is no feedback."""
        return self.family.awaited(off_bus(frame))

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs on the frame's bus that it is for."""
        return tuple(leg for leg in self.family.addressed(off_bus(frame)) if self.bus_of[leg] == frame.bus)

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame on its own bus, else -1."""
        known = off_bus(frame)
        return -1 if self._strays(frame, known) else self.family.sender(known)

    # drives' end

    def drives_end(self) -> DrivesEnd | None:
        """Return the drives' end by address where the family has it, else None."""
        make = getattr(self.family, "drives_end", None)
        return None if make is None else cast("DrivesEnd | None", make(self))

    def hearing(self) -> Hearing | None:
        """Return the controller's end by address, as far as it hears; None as `drives_end`."""
        make = getattr(self.family, "hearing", None)
        return None if make is None else cast("Hearing | None", make(self))

    def power_up(self) -> Memories:
        """Return the memories of drives that have heard nothing."""
        return tuple(self.family.power_up() for _ in self._buses)

    def parse(self, memory: Memories, frame: Frame) -> tuple[Memories, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end: the drives of the frame's bus hear it, and no others."""
        bus = frame.bus
        if bus >= len(self.legs):
            return memory, ()
        own, messages = self._parse(memory[bus], off_bus(frame), bus)
        at_home = [self._on(bus, message) for message in messages]
        kept = tuple(message for message in at_home if message is not None)
        return _with(memory, bus, own), kept

    def _parse(self, own: Memory, frame: Frame, bus: int) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode a frame at the drives of one bus; messages may name legs that are not there."""
        del bus
        return self.family.parse(own, frame)

    def _on(self, bus: int, message: DeviceMessage) -> DeviceMessage | None:
        """Return what a message says to the legs of a bus, an answer on that bus; None for nothing."""
        there = self.legs[bus]
        match message:
            case Answer(leg, frame):
                return Answer(leg, on_bus(frame, bus)) if leg in there else None
            case Configure(leg=leg):
                return message if leg in there else None
            case DeviceCommand(legs=named):  # of one bus: a frame has one leg, or slots of its own bus
                return message if named and named[0] in there else None
            case Sync(legs=named) | Alive(legs=named) | EmergencyStop(legs=named):
                legs = tuple(leg for leg in named if leg in there)
                return message._replace(legs=legs) if legs or not named else None
        return message

    def answer(
        self,
        memory: Memories,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[Memories, list[tuple[int, Frame]]]:
        """Encode what the drives of `sync.legs` answer, each on its own bus; see `DriveProtocol.answer`."""
        frames: list[tuple[int, Frame]] = []
        for bus in sorted({self.bus_of[leg] for leg in sync.legs}):
            own, answers = self.family.answer(memory[bus], sync, length, rate, force, state, fault)
            memory = _with(memory, bus, own)
            mine = set(self.legs[bus]).intersection(sync.legs)
            frames += [(leg, on_bus(frame, bus)) for leg, frame in answers if leg in mine]
        return memory, frames

    def report(self, memory: Memories, status: Status) -> tuple[Memories, tuple[Frame, ...]]:
        """Encode one drive's heartbeat, and learn what it is in."""
        bus = self.bus_of[status.leg]
        own, frames = self.family.report(memory[bus], status)
        return _with(memory, bus, own), tuple(on_bus(frame, bus) for frame in frames)

    def restarted(self, memory: Memories, legs: Sequence[int]) -> Memories:
        """Return the memory after drives were switched off and on."""
        for bus, there in enumerate(self.legs):
            again = [leg for leg in legs if leg in there]
            memory = _with(memory, bus, self.family.restarted(memory[bus], again))
        return memory

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame sent once per tick, on the bus where it is sent."""
        found: list[Frame] = []
        for frame in self.family.cyclic_frames():
            leg = self.family.sender(frame)
            found += [on_bus(frame, self.bus_of[leg])] if leg >= 0 else self.spread([frame])
        return tuple(found)


def _with(memory: Memories, bus: int, own: Memory) -> Memories:
    return (*memory[:bus], own, *memory[bus + 1 :])
