"""Family: the interface of every drive family's codec, with the assignment of frames to buses."""

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
    """The codec of six drives for the controller. It has constant tables only, and may be shared.

    Each frame goes on the bus of its leg, and a drive's frame counts on that bus only. Run-time state is in
    the `ControllerEnd`. The emulated drives' end is in `plant_fmu.drives`.
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
    """Identifier -> leg whose drive sends frames with it."""

    def __init__(self, nodes: Sequence[int], legs: Sequence[Sequence[int]] = (ALL_LEGS,)) -> None:
        """Set the drives' node numbers, in leg order, and the legs of each bus; a leg has one bus."""
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
        """Properties of the drive family, for bus load, loop and safety checks."""

    @abstractmethod
    def controller_end(self, setup: DriveSetup) -> ControllerEnd:
        """Compiled controller's end of six drives. Raises ProtocolError if the set-up does not fit."""

    def fault_text(self, _code: int) -> str:
        """Meaning of a fault code defined by the drive's maker; empty if unknown."""
        return ""

    def said_by(self, _frame: Frame) -> Said | None:
        """Serial or revision number that a drive reports in a frame, as received on bus 0; else None."""
        return None

    # the drive of a frame

    @cached_property
    def context(self) -> int:
        """Address of the codec's tables, an argument of the kernels `fresh_by` and `addressed_by`."""
        return data_at(self.tables)

    def to_leg(self, leg: int, frame: Frame) -> Frame:
        """The frame with its bus index set to the bus of a leg."""
        return frame._replace(flags=frame.flags % BUS + BUS * self.bus_of[leg])

    def to_each(self, frames: Iterable[Frame]) -> tuple[Frame, ...]:
        """Six frames for the drives, in leg order, each with the index of the bus of its leg."""
        return tuple(self.to_leg(leg, frame) for leg, frame in enumerate(frames))

    def to_all(self, frame: Frame) -> tuple[Frame, ...]:
        """Copies of a frame that all drives read, one for each bus."""
        return tuple(frame._replace(flags=frame.flags + BUS * bus) for bus in sorted(set(self.bus_of)))

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """True if a frame is valid feedback of this tick; until all six have come, the loop waits for frames.

        since_ns: start of the tick, before the frames of `begin` were sent.
        """
        return self.fresh_by(self.tables, received_array([received]), tick, since_ns) > 0

    def awaited(self, frame: Frame) -> int:
        """Identifier for which the loop waits, an element of `wanted`; any other number if not feedback."""
        return frame.id

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Legs (0..5) that a frame sent by a controller addresses."""
        legs = self.addressed_by(self.tables, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def sender(self, frame: Frame) -> int:
        """Leg whose drive sends a frame on its own bus; -1 for any other frame."""
        leg = self.senders.get(frame.id, -1)
        return leg if leg >= 0 and self.bus_of[leg] == frame.bus else -1

    def identity(self, frame: Frame) -> Said | None:
        """Serial or revision number that a drive reports on its own bus; None for any other frame."""
        said = self.said_by(off_bus(frame))
        return said if said is not None and self.bus_of[said.leg] == frame.bus else None

    def refuse_reaction(self, setup: DriveSetup) -> None:
        """Raise ProtocolError if the drives lack the set-up's reaction to a silent controller."""
        if setup.reaction not in self.traits.reactions:
            names = " or ".join(each.name.lower() for each in self.traits.reactions)
            raise ProtocolError(
                f"reactions.silence {setup.reaction.name.lower()}: these drives cannot do that by "
                f"themselves, allowed: {names}"
            )

    def refuse_nodes(self, least: int, most: int, family: str, why: str = "", but: int = -1) -> None:
        """Raise ConfigurationError for a node number outside least..most or equal to `but`; why: reason."""
        for leg, node in enumerate(self.nodes):
            if not least <= node <= most or node == but:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed with {family}: {least} to {most}{why}, "
                    f"given: {node}"
                )
