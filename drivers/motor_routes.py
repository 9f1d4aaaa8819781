"""Which drive of a family of single motors a frame concerns."""

from abc import ABC, abstractmethod
from typing import Any

from drivers.protocol import Frame


class MotorRoutes(ABC):
    """Every frame of such a family is for one drive, or from one."""

    @abstractmethod
    def hear(self, frame: Frame) -> Any:
        """Return what a drive's frame says; None for a frame that is nobody's."""

    @abstractmethod
    def leg_addressed(self, frame: Frame) -> int | None:
        """Return the leg that a frame of the controller's end is for; None for none of ours."""

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame of the controller's end is for."""
        leg = self.leg_addressed(frame)
        return () if leg is None else (leg,)

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame, -1 for a frame of nobody or of a controller."""
        heard = self.hear(frame)
        return -1 if heard is None or heard.foreign else int(heard.leg)
