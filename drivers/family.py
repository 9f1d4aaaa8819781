"""What the codecs of all families share: each frame goes on the bus of the leg that it is for."""

import ctypes
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from functools import cached_property

from drivers.compiled.pointed import data_at
from drivers.ends import Hearing
from drivers.frame_array import received_array, sent_array
from drivers.protocol import ALL_LEGS, BUS, DriveProtocol, Frame, Received
from drivers.signals import LEGS

_ASK = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64, ctypes.c_int64)
_FRESH = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * 4)


class Family(DriveProtocol):
    """Holds tables only. A drive's frame counts on its own bus alone."""

    def __init__(self, legs: Sequence[Sequence[int]] = (ALL_LEGS,)) -> None:
        """Take the legs of each bus, which together are all legs, each once."""
        self.legs = tuple(map(tuple, legs))
        self.buses = len(legs) if len(legs) > 1 else 0
        """How many there are; 0: one, and frames of others are nobody's."""
        self.bus_of = tuple(next(bus for bus, own in enumerate(legs) if leg in own) for leg in range(LEGS))
        """Index of each leg's bus."""

    @abstractmethod
    def hearing(self) -> Hearing:
        """Return the controller's end by address, as far as it hears."""

    @cached_property
    def _hears(self) -> Hearing:
        return self.hearing()

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
        """Tell whether a frame is feedback of this tick that can be trusted; see `Hearing.fresh`."""
        hears, frame = self._hears, received_array([received])
        return bool(_FRESH(hears.fresh)(hears.context, data_at(frame), tick, since_ns) > 0)

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame of the controller's end is for; see `Hearing.addressed`."""
        hears, given = self._hears, sent_array([frame])
        legs = _ASK(hears.addressed)(hears.context, data_at(given))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)
