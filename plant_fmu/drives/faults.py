"""What can go wrong at the plant's end and on its bus, as a list of timed faults.

Times are seconds after `Nodes.start`, legs are 0..5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.protocol import Frame
from drivers.signals import LEGS


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault that is present for start_s <= t < stop_s."""

    start_s: float = 0.0
    stop_s: float = inf

    def __post_init__(self) -> None:
        if not (0.0 <= self.start_s < self.stop_s and isfinite(self.start_s)):
            raise ConfigurationError(f"{self}: 0 <= start_s < stop_s is needed")

    def active(self, t_s: float) -> bool:
        """Tell whether the fault is present at this instant."""
        return self.start_s <= t_s < self.stop_s


@dataclass(frozen=True, kw_only=True)
class LegFault(Fault):
    """A fault of one leg."""

    leg: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.leg not in range(LEGS):
            raise ConfigurationError(f"{self}: leg is 0 to {LEGS - 1}")


@dataclass(frozen=True, kw_only=True)
class EncoderOffset(LegFault):
    """The encoder slips: it reads this much more than the length."""

    offset_m: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _finite(self, self.offset_m)


@dataclass(frozen=True, kw_only=True)
class EncoderFreeze(LegFault):
    """The encoder keeps the length of the moment the fault begins, at rate zero."""


@dataclass(frozen=True, kw_only=True)
class EncoderLost(LegFault):
    """The drive knows that its encoder is lost: it says so in its feedback, and still obeys."""


@dataclass(frozen=True, kw_only=True)
class LegGain(LegFault):
    """The leg's force is this multiple of what its drive means to apply; -1 is swapped wires."""

    gain: float = -1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _finite(self, self.gain)


@dataclass(frozen=True, kw_only=True)
class Silence(LegFault):
    """The drive sends nothing. It still hears."""


@dataclass(frozen=True, kw_only=True)
class StuckBrake(LegFault):
    """The brake stays where it is told here, whatever the drive wants."""

    engaged: bool = True


@dataclass(frozen=True, kw_only=True)
class WrenchStep(Fault):
    """A wrench on the platform at its origin, base frame; several add up."""

    wrench: tuple[float, float, float, float, float, float]
    """N, N m."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.wrench) != LEGS:
            raise ConfigurationError(f"{self}: a wrench has three forces and three moments")
        _finite(self, *self.wrench)


@dataclass(frozen=True, kw_only=True)
class FrameFault(Fault):
    """A fault of the frames of one identifier, or of all, in both directions."""

    probability: float = 1.0
    identifier: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.probability <= 1.0:
            raise ConfigurationError(f"{self}: probability is 0 to 1")


@dataclass(frozen=True, kw_only=True)
class FrameLoss(FrameFault):
    """The frame never arrives."""


@dataclass(frozen=True, kw_only=True)
class FrameCorruption(FrameFault):
    """One bit of the data is flipped behind the back of the bus' own check, as a bad gateway does."""


def _finite(fault: Fault, *values: float) -> None:
    if not all(isfinite(value) for value in values):
        raise ConfigurationError(f"{fault}: values must be finite")


class Present:
    """The faults of drives and plant at one instant, per leg where they are a leg's."""

    def __init__(self, faults: Sequence[Fault], t_s: float) -> None:
        self.offset_m = [0.0] * LEGS
        self.frozen = [False] * LEGS
        self.lost = [False] * LEGS
        self.gain = [1.0] * LEGS
        self.silent = [False] * LEGS
        self.stuck: list[bool | None] = [None] * LEGS
        """True engaged, False released, None works."""
        self.wrench: Array = np.zeros(LEGS)
        for fault in faults:
            if not fault.active(t_s):
                continue
            match fault:
                case EncoderOffset(leg=leg, offset_m=offset_m):
                    self.offset_m[leg] += offset_m
                case EncoderFreeze(leg=leg):
                    self.frozen[leg] = True
                case EncoderLost(leg=leg):
                    self.lost[leg] = True
                case LegGain(leg=leg, gain=gain):
                    self.gain[leg] *= gain
                case Silence(leg=leg):
                    self.silent[leg] = True
                case StuckBrake(leg=leg, engaged=engaged):
                    self.stuck[leg] = engaged
                case WrenchStep(wrench=wrench):
                    self.wrench += wrench


class FaultPlan:
    """The faults of one run. `seed` decides which frames suffer."""

    def __init__(self, faults: Sequence[Fault] = (), seed: int = 0) -> None:
        self.seed = seed
        self._timed = [fault for fault in faults if not isinstance(fault, FrameFault)]
        self._frames = [fault for fault in faults if isinstance(fault, FrameFault)]
        self.touches_frames = bool(self._frames)
        """Whether `pass_on` can change anything."""

    def edges_s(self) -> list[float]:
        """Return the instants at which a fault of drives or plant begins or ends, rising."""
        edges = {edge for fault in self._timed for edge in (fault.start_s, fault.stop_s)}
        return sorted(edge for edge in edges if edge < inf)

    def present(self, t_s: float) -> Present:
        """Return the faults of drives and plant at this instant."""
        return Present(self._timed, t_s)

    def pass_on(self, frame: Frame, t_s: float, generator: np.random.Generator) -> Frame | None:
        """Return the frame as it arrives, or None if it is lost. Draws from `generator`."""
        for fault in self._frames:
            if not fault.active(t_s) or fault.identifier not in (None, frame.id):
                continue
            if generator.random() >= fault.probability:
                continue
            if isinstance(fault, FrameLoss):
                return None
            if frame.data:
                bit = int(generator.integers(8 * len(frame.data)))
                data = bytearray(frame.data)
                data[bit // 8] ^= 1 << bit % 8
                frame = frame._replace(data=bytes(data))
        return frame
