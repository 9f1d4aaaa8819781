"""The own protocol on several buses: each bus has its own command, with the forces of its legs alone.

CONFIG tells a drive its slot: the place of its leg among those of its bus. On a bus with three legs or fewer
the command has room for three forces. The cyclic frames go by tables of identifiers: the loop has no time to
ask the family for each.
"""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Rows
from drivers.ends import Hearing
from drivers.legs.controller import LegsController, LegsDialogue, decoded, encoded
from drivers.legs.drives_end import LegsEnd
from drivers.legs.messages import SHORT
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import (
    ALWAYS,
    BUS,
    OTHER_BUSES,
    DeviceCommand,
    DeviceMessage,
    Dialogue,
    DriveSetup,
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
        self._syncs = [self.spread(self._first.begin(None, cycle)) for cycle in range(256)]
        rows = [
            row
            for bus, (codec, there) in enumerate(zip(self._codecs, self.legs, strict=True))
            for row in codec.command_rows(there, bus)
        ]
        self._codec, self._codec_keeps = self._first.codec(rows, len(self.legs), self.bus_of)
        self._home = {identifier: BUS * self.bus_of[leg] for identifier, leg in self._first.senders.items()}
        self._beyond = BUS * len(self.legs)

    def begin(self, _dialogue: Dialogue, tick: int) -> tuple[Frame, ...]:
        """Return SYNC on every bus."""
        return self._syncs[tick & 0xFF]

    def command(self, dialogue: Dialogue, command: Command, tick: int) -> tuple[Dialogue, tuple[Frame, ...]]:
        """Return one tick's command frames of each bus. Raises ProtocolError as `LegsProtocol.command`."""
        frames = encoded(self._codec, command, tick)
        if not frames:
            for codec, there in zip(self._codecs, self.legs, strict=True):
                force = np.zeros(LEGS)
                force[: len(there)] = command.force[list(there)]
                codec.command(dialogue, command._replace(force=force), tick)
        return dialogue, frames

    def controller_end(self, setup: DriveSetup) -> LegsController:
        """Return the controller's end, compiled."""
        return LegsController(self, setup, self._codec, self._syncs)

    def decode(
        self, dialogue: LegsDialogue, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> LegsDialogue:
        """Fill the measurement of a tick; see `SeveralBuses.decode`."""
        return decoded(self._codec, dialogue, frames, last, tick, since_ns, self.heard)

    def heard(self, said: tuple[int, ...], frames: Rows) -> tuple[int, ...]:
        """Return what the drives have said of their set-up, each on its own bus."""
        known = [self._home.get(each) == BUS * bus for each, bus in frames[["id", "bus"]].tolist()]
        at_home = frames[known].copy()
        at_home["bus"] = 0
        return self._first.heard(said, at_home)

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is an intact feedback to this tick's SYNC, on its drive's own bus."""
        t_ns, (identifier, data, flags) = received
        own = flags & OTHER_BUSES
        known = Received(t_ns, Frame(identifier, data, flags - own))
        return self._home.get(identifier) == own and self._first.fresh(known, tick, since_ns)

    def awaited(self, frame: Frame) -> int:
        """Return the identifier."""
        return frame.id

    def drives_end(self) -> LegsEnd | None:
        """Return the drives' end by address, powered up; None for a protocol that changes it."""
        return LegsEnd(self._codecs, self.legs) if type(self) is LegsOnBuses else None

    def hearing(self) -> Hearing | None:
        """Return the controller's end by address, as far as it hears; None as `drives_end`."""
        end, ids = self.drives_end(), self._first.feedback_by_leg
        return None if end is None else end.hearing(ids)

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
