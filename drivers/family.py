"""Family: the interface of every drive family's codec, and the bus of each frame."""

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

    Each frame goes on the bus of its leg, and a drive's frame counts on that bus only. The controller's state
    is in its end. The emulated drives' end is in `plant_fmu.drives`.
    """

    fresh_by: Pointed
    """``(tables, frame, tick, since_ns)`` -> index in `wanted`, from 1 on, of a `fresh` frame; else 0."""
    addressed_by: Pointed
    """``(tables, frame)`` -> legs that a frame addresses, bit i: leg i."""
    tables: Any
    """Record of the family's tables."""
    wanted: tuple[int, ...]
    """`Traits.feedback_ids` as a sequence."""
    senders: Mapping[int, int]
    """Identifier -> leg whose drive sends it."""

    def __init__(self, nodes: Sequence[int], legs: Sequence[Sequence[int]] = (ALL_LEGS,)) -> None:
        """Take the drives' node numbers, and the legs of each bus; each leg is on one bus."""
        self.nodes = tuple(nodes)
        self.legs = tuple(map(tuple, legs))
        self.buses = len(legs)
        """Number of buses; frames of other buses are ignored."""
        self.bus_of = tuple(next(bus for bus, own in enumerate(legs) if leg in own) for leg in range(LEGS))
        """Index of each leg's bus."""

    # members that a family supplies

    @cached_property
    @abstractmethod
    def traits(self) -> Traits:
        """Properties of the family."""

    @abstractmethod
    def controller_end(self, setup: DriveSetup) -> ControllerEnd:
        """The controller's end. Raises ProtocolError if the set-up does not fit."""

    def fault_text(self, _code: int) -> str:
        """Meaning of a fault code of the drive's own, in its maker's words; empty if unknown."""
        return ""

    def said_by(self, _frame: Frame) -> Said | None:
        """Serial number or revision that a frame, as it is on bus 0, reports; else None."""
        return None

    # the drive of a frame

    @cached_property
    def context(self) -> int:
        """Address of the tables, for `fresh_by` and `addressed_by`."""
        return data_at(self.tables)

    def to_leg(self, leg: int, frame: Frame) -> Frame:
        """Frame on the bus of a leg."""
        return frame._replace(flags=frame.flags % BUS + BUS * self.bus_of[leg])

    def to_each(self, frames: Iterable[Frame]) -> tuple[Frame, ...]:
        """Frames for the drives, in leg order, each on the bus of its leg."""
        return tuple(self.to_leg(leg, frame) for leg, frame in enumerate(frames))

    def to_all(self, frame: Frame) -> tuple[Frame, ...]:
        """Copies of a frame for all drives, one on each bus."""
        return tuple(frame._replace(flags=frame.flags + BUS * bus) for bus in sorted(set(self.bus_of)))

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """True if a frame is trusted feedback of this tick; after other frames the drain keeps waiting.

        since_ns: start of the tick, before the frames of `begin` were sent.
        """
        return self.fresh_by(self.tables, received_array([received]), tick, since_ns) > 0

    def awaited(self, frame: Frame) -> int:
        """Element of `wanted` that a frame matches; another number for a frame that is not feedback."""
        return frame.id

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Legs that a frame of the controller's end addresses."""
        legs = self.addressed_by(self.tables, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def sender(self, frame: Frame) -> int:
        """Leg whose drive sends a frame on its own bus; -1 for any other frame."""
        leg = self.senders.get(frame.id, -1)
        return leg if leg >= 0 and self.bus_of[leg] == frame.bus else -1

    def identity(self, frame: Frame) -> Said | None:
        """Serial number or revision that a drive on the frame's bus reports; else None."""
        said = self.said_by(off_bus(frame))
        return said if said is not None and self.bus_of[said.leg] == frame.bus else None

    def refuse_reaction(self, setup: DriveSetup) -> None:
        """Raise ProtocolError for a reaction that the drives do not have."""
        if setup.reaction not in self.traits.reactions:
            names = " or ".join(each.name.lower() for each in self.traits.reactions)
            raise ProtocolError(
                f"reactions.silence {setup.reaction.name.lower()}: these drives cannot do that by "
                f"themselves, allowed: {names}"
            )

    def refuse_nodes(self, least: int, most: int, family: str, why: str = "", but: int = -1) -> None:
        """Raise ConfigurationError for a node number that is out of range or equals `but`."""
        for leg, node in enumerate(self.nodes):
            if not least <= node <= most or node == but:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed with {family}: {least} to {most}{why}, "
                    f"given: {node}"
                )
