"""The own protocol on several buses: each bus has its own command, with the forces of its legs alone.

CONFIG tells a drive its slot: the place of its leg among those of its bus. On a bus with three legs or fewer
the command has room for three forces. The cyclic frames go by tables of identifiers: the loop has no time to
ask the family for each.
"""

from collections.abc import Sequence

import numpy as np

from drivers.legs.messages import SHORT
from drivers.legs.protocol import LegsDialogue, LegsProtocol
from drivers.protocol import (
    ALWAYS,
    BUS,
    HEAD,
    OTHER_BUSES,
    DeviceCommand,
    DeviceMessage,
    Dialogue,
    Frame,
    Memory,
    Received,
    Sync,
)
from drivers.several_buses import SeveralBuses
from drivers.signals import LEGS, Command, DriveMode
from drivers.tick_columns import Record


class LegsOnBuses(SeveralBuses):
    """As `SeveralBuses`, with commands of its own. Holds tables only."""

    def __init__(
        self, layout: str, node_ids: Sequence[int], rated_force_N: float, legs: Sequence[Sequence[int]]
    ) -> None:
        """Take what `LegsProtocol` takes, and the legs of each bus. Raises ConfigurationError as it does."""
        slots = [next(there.index(leg) for there in legs if leg in there) for leg in range(LEGS)]
        by_places = {
            places: LegsProtocol(layout, node_ids, rated_force_N, slots, places)
            for places in {SHORT if len(there) <= SHORT else LEGS for there in legs}
        }
        self._codecs = [by_places[SHORT if len(there) <= SHORT else LEGS] for there in legs]
        self._first = self._codecs[0]
        super().__init__(self._first, legs)
        self._chosen = [np.array(there) for there in self.legs]
        self._syncs = [self._spread(self._first.begin(None, cycle)) for cycle in range(256)]
        self._home = {identifier: BUS * self.bus_of[leg] for identifier, leg in self._first.senders.items()}
        self._beyond = BUS * len(self.legs)

    def begin(self, _dialogue: Dialogue, tick: int) -> tuple[Frame, ...]:
        """Return SYNC on every bus."""
        return self._syncs[tick & 0xFF]

    def command(self, dialogue: Dialogue, command: Command, tick: int) -> tuple[Dialogue, tuple[Frame, ...]]:
        """Return one tick's command frames of each bus. Raises ProtocolError as `LegsProtocol.command`."""
        sent: list[Frame] = []
        for bus, (codec, chosen) in enumerate(zip(self._codecs, self._chosen, strict=True)):
            force = np.zeros(LEGS)
            force[: len(chosen)] = command.force[chosen]
            _, frames = codec.command(dialogue, command._replace(force=force), tick)
            sent += [Frame(identifier, data, flags + BUS * bus) for identifier, data, flags in frames]
        return dialogue, tuple(sent)

    def decode(
        self, dialogue: LegsDialogue, run: bytes, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> LegsDialogue:
        """Fill the measurement of a tick; see `SeveralBuses.decode`."""
        home, beyond = self._home, self._beyond
        kept, strays, end = [], 0, 0
        while end < len(run):
            start = end
            t_ns, identifier, flags, size = HEAD.unpack_from(run, start)
            at = start + HEAD.size
            end = at + size
            bus = flags & OTHER_BUSES
            if home.get(identifier, bus) != bus or bus >= beyond:
                strays += 1
            elif bus:
                kept += [HEAD.pack(t_ns, identifier, flags - bus, size), run[at:end]]
            else:
                kept.append(run[start:end])
        dialogue = self._first.decode(dialogue, b"".join(kept), last, tick, since_ns)
        if strays:
            tick["rejected"] += strays
        return dialogue

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is an intact feedback to this tick's SYNC, on its drive's own bus."""
        t_ns, (identifier, data, flags) = received
        own = flags & OTHER_BUSES
        known = Received(t_ns, Frame(identifier, data, flags - own))
        return self._home.get(identifier) == own and self._first.fresh(known, tick, since_ns)

    def awaited(self, frame: Frame) -> int:
        """Return the identifier."""
        return frame.id

    def _parse(self, own: Memory, frame: Frame, bus: int) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode a frame at the drives of one bus; a command's slots become their legs."""
        own, messages = self._codecs[bus].parse(own, frame)
        there = self.legs[bus]
        return own, tuple(
            message._replace(
                legs=tuple(there[slot] for slot in message.legs if slot < len(there)),
                force=message.force[[slot < len(there) for slot in message.legs]],
            )
            if isinstance(message, DeviceCommand)
            else message
            for message in messages
        )

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: SYNC, commands, feedbacks, each bus its own."""
        zeros = np.zeros(LEGS)
        _, command = self.command(None, Command(DriveMode.OFF, zeros), 0)
        off = np.ones(LEGS, np.int64)
        _, feedbacks = self.answer(self.power_up(), Sync(0), zeros, zeros, zeros, off)
        return (*self.begin(None, 0), *command, *(frame for _, frame in feedbacks))
