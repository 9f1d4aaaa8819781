"""The codecs of all families: on which bus a frame goes, and the controller's end by address as it hears."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple, cast

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import Pointed, data_at, of_python
from drivers.controller_end import array_at
from drivers.frame_array import FRAME, received_array, received_frames, sent_array
from drivers.protocol import ALL_LEGS, BUS, DriveProtocol, Frame, Received
from drivers.signals import LEGS


class Hearing(NamedTuple):
    """What the controller's end makes of frames, by address."""

    fresh: int
    """(context, frame, tick, since_ns) -> the place in `wanted` of a frame that is `fresh`, from 1 on; 0 for
    one that is not."""
    addressed: int
    """(context, frame) -> bit i: a frame is for leg i."""
    context: int
    wanted: tuple[int, ...]
    """`Traits.feedback_ids`."""
    keeps: Any


class Family(DriveProtocol):
    """What the codecs of all families share: each frame goes on the bus of the leg that it is for.

    Holds tables only. A drive's frame counts on its own bus alone.
    """

    fresh_by: Pointed
    """`Hearing.fresh`, of `tables`."""
    addressed_by: Pointed
    """`Hearing.addressed`, of the same."""
    tables: Any
    """A record of what the family knows."""
    wanted: tuple[int, ...]
    """`Traits.feedback_ids`, in an order."""
    senders: Mapping[int, int]
    """Identifier -> the leg whose drive sends it."""

    def __init__(self, legs: Sequence[Sequence[int]] = (ALL_LEGS,)) -> None:
        """Take the legs of each bus, which together are all legs, each once."""
        self.legs = tuple(map(tuple, legs))
        self.buses = len(legs)
        """How many there are; frames of others are nobody's."""
        self.bus_of = tuple(next(bus for bus, own in enumerate(legs) if leg in own) for leg in range(LEGS))
        """Index of each leg's bus."""

    def hearing(self) -> Hearing:
        """Return the controller's end by address, as far as it hears."""
        by = self.fresh_by.address, self.addressed_by.address
        return Hearing(*by, data_at(self.tables), self.wanted, self)

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
        """Tell whether a frame is feedback of this tick that can be trusted."""
        return self.fresh_by(self.tables, received_array([received]), tick, since_ns) > 0

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame of the controller's end is for."""
        legs = self.addressed_by(self.tables, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame on its own bus, -1 for any other frame."""
        leg = self.senders.get(frame.id, -1)
        return leg if leg >= 0 and self.bus_of[leg] == frame.bus else -1


def hearing(protocol: DriveProtocol) -> Hearing:
    """Return the controller's end of a protocol, as far as it hears."""
    compiled = getattr(protocol, "hearing", None)
    return _python_hearing(protocol) if compiled is None else cast("Hearing", compiled())


def _python_hearing(protocol: DriveProtocol) -> Hearing:
    wanted = tuple(sorted(protocol.traits.feedback_ids))
    places = {each: place for place, each in enumerate(wanted, 1)}

    def fresh(_context: int, frame: int, tick: int, since_ns: int) -> int:
        (received,) = received_frames(array_at(frame, 1, FRAME))
        if not protocol.fresh(received, tick, since_ns):
            return 0
        return places.get(protocol.awaited(received.frame), len(wanted) + 1)

    def addressed(_context: int, frame: int) -> int:
        (received,) = received_frames(array_at(frame, 1, FRAME))
        return sum(1 << leg for leg in protocol.addressed(received.frame))

    looks, keeps_fresh = of_python(fresh, *[INTEGER] * 4)
    asks, keeps_addressed = of_python(addressed, *[INTEGER] * 2)
    return Hearing(looks, asks, 0, wanted, (keeps_fresh, keeps_addressed))
