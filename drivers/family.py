"""Family: what the codec of every drive family gives, and on which bus a frame goes."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

from drivers.compiled.pointed import Pointed, data_at
from drivers.controller_end import ControllerEnd
from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_array import received_array, sent_array
from drivers.protocol import ALL_LEGS, BUS, DriveSetup, Frame, Received, Said, Traits, off_bus
from drivers.signals import LEGS


class Family(ABC):
    """The codec of six drives, from the controller's side. Holds tables only, and is shared.

    Each frame goes on the bus of the leg that it is for, and a drive's frame counts on its own bus alone.
    What the controller remembers is in its end. The emulated drives' end is in `plant_fmu.drives`.
    """

    fresh_by: Pointed
    """``(tables, frame, tick, since_ns)`` -> the place in `wanted`, from 1 on, of a frame that is `fresh`;
    else 0."""
    addressed_by: Pointed
    """``(tables, frame)`` -> bit i: a frame is for leg i."""
    tables: Any
    """A record of what the family knows."""
    wanted: tuple[int, ...]
    """`Traits.feedback_ids`, in an order."""
    senders: Mapping[int, int]
    """Identifier -> the leg whose drive sends it."""

    def __init__(self, nodes: Sequence[int], legs: Sequence[Sequence[int]] = (ALL_LEGS,)) -> None:
        """Take the drives' numbers, and the legs of each bus, which together are all legs, each once."""
        self.nodes = tuple(nodes)
        self.legs = tuple(map(tuple, legs))
        self.buses = len(legs)
        """How many there are; frames of other buses are ignored."""
        self.bus_of = tuple(next(bus for bus, own in enumerate(legs) if leg in own) for leg in range(LEGS))
        """Index of each leg's bus."""

    # what a family gives

    @cached_property
    @abstractmethod
    def traits(self) -> Traits:
        """What the family is."""

    @abstractmethod
    def controller_end(self, setup: DriveSetup) -> ControllerEnd:
        """Return the controller's end. Raises ProtocolError if the set-up does not fit."""

    def fault_text(self, _code: int) -> str:
        """Meaning of a fault code of the drive's own, in its maker's words; empty if unknown."""
        return ""

    def said_by(self, _frame: Frame) -> Said | None:
        """Return the serial number or revision that a frame, as it is on bus 0, reports; else None."""
        return None

    # which drive a frame concerns

    @cached_property
    def context(self) -> int:
        """Address of the tables, for `fresh_by` and `addressed_by`."""
        return data_at(self.tables)

    def to_leg(self, leg: int, frame: Frame) -> Frame:
        """Return a frame on the bus of a leg."""
        return frame._replace(flags=frame.flags % BUS + BUS * self.bus_of[leg])

    def to_each(self, frames: Iterable[Frame]) -> tuple[Frame, ...]:
        """Return frames for the drives, leg order, each on the bus of its leg."""
        return tuple(self.to_leg(leg, frame) for leg, frame in enumerate(frames))

    def to_all(self, frame: Frame) -> tuple[Frame, ...]:
        """Return a frame that is for all drives, on each bus."""
        return tuple(frame._replace(flags=frame.flags + BUS * bus) for bus in sorted(set(self.bus_of)))

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is feedback of this tick that can be trusted: the drain waits for others.

        since_ns: when the tick began, before the frames of `begin` were sent.
        """
        return self.fresh_by(self.tables, received_array([received]), tick, since_ns) > 0

    def awaited(self, frame: Frame) -> int:
        """Return which of `wanted` a frame is; another number for what is no feedback."""
        return frame.id

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame of the controller's end is for."""
        legs = self.addressed_by(self.tables, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame on its own bus, -1 for any other frame."""
        leg = self.senders.get(frame.id, -1)
        return leg if leg >= 0 and self.bus_of[leg] == frame.bus else -1

    def identity(self, frame: Frame) -> Said | None:
        """Return the serial number or revision that a drive on the frame's bus reports; else None."""
        said = self.said_by(off_bus(frame))
        return said if said is not None and self.bus_of[said.leg] == frame.bus else None

    def refuse_reaction(self, setup: DriveSetup) -> None:
        """Raise ProtocolError for what the drives do not do by themselves."""
        if setup.reaction not in self.traits.reactions:
            names = " or ".join(each.name.lower() for each in self.traits.reactions)
            raise ProtocolError(
                f"reactions.silence {setup.reaction.name.lower()}: these drives {names} by themselves; "
                "write that"
            )

    def refuse_nodes(self, least: int, most: int, family: str, why: str = "", but: int = -1) -> None:
        """Raise ConfigurationError for a drive's number that is out of range, or `but`."""
        for leg, node in enumerate(self.nodes):
            if not least <= node <= most or node == but:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed with {family}: {least} to {most}{why}, "
                    f"given: {node}"
                )
