"""What faults have in common: when they begin and end, and where they act.

Times count from `Nodes.start`, or from the instant at which the controller reaches a mode. Legs are 0..5.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
from pydantic import Field

from drivers.arrays import Array
from drivers.protocol import Frame
from drivers.section import Section
from drivers.signals import LEGS

Moment = Literal[
    "IDLE", "LOADING", "RELEASING", "APPROACH", "TRACKING",
    "HOLD", "STOPPING", "PARKING", "UNLOADING", "PARKED",
]  # fmt: skip
"""Modes of the controller; HOLD: the reference is at rest in TRACKING."""
NEVER_NS = 1 << 62
Effect = tuple[str, Callable[[Any, Any], Any] | None, object]
"""An entry of `Present`; what makes its new value of the old one and a figure, None where it lists figures
with their leg and since when; that figure or its field."""


class Present:
    """The faults of drives and plant at one instant, per leg where they are a leg's."""

    def __init__(self) -> None:
        self.since_ns: int
        """When the fault began that is entered now."""
        self.generator: np.random.Generator
        """The chance of the fault that is entered now."""
        self.offset_m = [0.0] * LEGS
        self.drifts: list[tuple[int, float, int]] = []
        """Leg, m/s, since when in ns."""
        self.noise: list[tuple[int, float, np.random.Generator]] = []
        """Leg, standard deviation in m, its chance."""
        self.late_ns = [0] * LEGS
        self.scales: list[tuple[int, float, int]] = []
        """Leg, multiple of what its encoder moves, since when in ns."""
        self.frozen = [False] * LEGS
        self.lost = [False] * LEGS
        self.forged_m: list[float | None] = [None] * LEGS
        """How much longer a second answer of the leg's node says that the leg is."""
        self.gain = [1.0] * LEGS
        self.saturation_N = [np.inf] * LEGS
        self.silent = [False] * LEGS
        self.reset = [False] * LEGS
        self.stuck: list[bool | None] = [None] * LEGS
        """True engaged, False released, None works."""
        self.slow_ns = [0] * LEGS
        """How much later than its drive counts the brake has opened or closed."""
        self.share = [1.0] * LEGS
        """Of the brake's force."""
        self.wrench: Array = np.zeros(LEGS)
        """(6,) N, N m on the platform at its origin, base frame."""
        self.masses: list[tuple[float, Array]] = []
        """kg, and where they lie on the platform: (3,) m, platform frame."""
        self.bus_off = 0
        """Bit i: bus i is cut."""
        self.not_finite = self.hangs = self.crashes = False


FAULTS: dict[str, type[Fault]] = {}
"""`kind` of a fault -> its class, in the order in which they are defined."""


class Fault(Section):
    """A fault that begins at an instant. Each kind states its name as `kind` in the head of its class.

    Raises ValidationError on senseless values.
    """

    effect: ClassVar[Effect | None] = None
    kind: Any = None
    at_s: Annotated[float, Field(ge=0)] = 0.0
    """When it begins: after the drives' power-up, or after `mode` is reached."""
    mode: Moment | None = None
    """The mode of the controller that `at_s` counts from."""

    def __init_subclass__(cls, kind: str | None = None, effect: Effect | None = None, **given: Any) -> None:
        """Make a kind of the class: a row of `FAULTS`, and the one value that its field `kind` takes."""
        super().__init_subclass__(**given)
        cls.effect = effect or cls.effect
        if kind is not None:
            cls.__annotations__["kind"], cls.kind = Literal[kind], kind
            FAULTS[kind] = cls

    @property
    def lasts_ns(self) -> int:
        """How long it is present; by default for an instant."""
        return 1

    def act(self, present: Present) -> None:
        """Enter what the fault does to drives and plant, in its leg where it has one."""
        if self.effect is None:
            return
        (entry, join, figure), fault = self.effect, cast("Any", self)
        value = getattr(fault, figure) if isinstance(figure, str) else figure
        if join is None:
            getattr(present, entry).append((fault.leg, value, present.since_ns))
        elif hasattr(fault, "leg"):
            entries = getattr(present, entry)
            entries[fault.leg] = join(entries[fault.leg], value)
        else:
            setattr(present, entry, join(getattr(present, entry), value))


def last(_: object, figure: object) -> object:
    """Of several faults the last one counts."""
    return figure


def later(ns: int, by_ms: float) -> int:
    """Several delays add up."""
    return ns + round(by_ms * 1e6)


class LastingFault(Fault):
    """A fault that is present for `for_s`."""

    for_s: Annotated[float, Field(gt=0)] | None = None
    """How long it is present; default: to the end."""

    @property
    def lasts_ns(self) -> int:
        """How long it is present."""
        return NEVER_NS if self.for_s is None else max(1, round(self.for_s * 1e9))


class LegFault(LastingFault):
    """A fault of one leg."""

    leg: Annotated[int, Field(ge=0, lt=LEGS)]


class Occurrence:
    """A fault in one run.

    Mutable state: when it begins, its chance, frames that it has seen, by `Place`, how often it has sent.
    """

    def __init__(self, fault: Fault, start_ns: int, generator: np.random.Generator) -> None:
        self.fault, self.start_ns, self.generator = fault, start_ns, generator
        self.frames: dict[Place, list[Frame]] = {}
        self.sent = 0

    @property
    def stop_ns(self) -> int:
        """When it ends; beyond NEVER_NS where it does not begin."""
        return self.start_ns + self.fault.lasts_ns


Place = tuple[bool, int, int]
"""Whether a frame is for the drives, the index of its bus, and its identifier."""


class Passage(LastingFault):
    """A fault of frames on their way, in both directions."""

    adds: ClassVar[bool] = False
    """Whether frames after the first are sent by somebody else, and heard by both ends."""

    def concerns(self, frame: Frame) -> bool:
        """Tell whether the fault may strike this frame: by its own identifier and bus, where it has them."""
        identifier, bus = getattr(self, "identifier", None), getattr(self, "bus", None)
        return identifier in (None, frame.id) and bus in (None, frame.bus)

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Return when and as what a frame arrives that was due at `t_ns`. Changes `own`."""
        raise NotImplementedError


class FrameFault(Passage):
    """A fault of the frames of one identifier, or of all, in both directions."""

    copies: ClassVar[int] = 1
    """How many of a frame that is struck arrive."""
    probability: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Of a frame to be struck."""
    identifier: Annotated[int, Field(ge=0)] | None = None
    """Of the frames that may be struck; default: all."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Decides which frames are struck."""

    def carry(self, t_ns: int, frame: Frame, _place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Strike at random."""
        if own.generator.random() < self.probability:
            return self.strike(t_ns, frame, own.generator)
        return [(t_ns, frame)]

    def strike(self, t_ns: int, frame: Frame, _generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Frames that are left of one that is struck. May draw from the generator."""
        return [(t_ns, frame)] * self.copies
