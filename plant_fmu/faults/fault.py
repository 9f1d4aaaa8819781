"""Base classes of all faults: when they begin and end, and on what they act.

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
"""Effect of a kind of fault: entry of `Present`; function (old value, figure) -> new value, or None for an
entry that lists (leg, figure, since when); the figure, or the name of the field that has it."""


class Present:
    """The faults of drives and plant at one instant; an element per leg for faults of legs."""

    def __init__(self) -> None:
        self.since_ns: int
        """Start of the fault that is being entered."""
        self.generator: np.random.Generator
        """Random numbers of the fault that is being entered."""
        self.offset_m = [0.0] * LEGS
        self.drifts: list[tuple[int, float, int]] = []
        """Leg, m/s, start in ns."""
        self.noise: list[tuple[int, float, np.random.Generator]] = []
        """Leg, standard deviation in m, random numbers."""
        self.late_ns = [0] * LEGS
        self.scales: list[tuple[int, float, int]] = []
        """Leg, factor on the motion that its encoder counts, start in ns."""
        self.frozen = [False] * LEGS
        self.lost = [False] * LEGS
        self.forged_m: list[float | None] = [None] * LEGS
        """Difference between the length in a second answer of the leg's node and its reading; None: no
        second answer."""
        self.gain = [1.0] * LEGS
        self.saturation_N = [np.inf] * LEGS
        self.silent = [False] * LEGS
        self.reset = [False] * LEGS
        self.stuck: list[bool | None] = [None] * LEGS
        """True engaged, False released, None: the brake works."""
        self.slow_ns = [0] * LEGS
        """Delay of each brake's movement after the time that its drive assumes."""
        self.share = [1.0] * LEGS
        """Share of each brake's force that is left."""
        self.wrench: Array = np.zeros(LEGS)
        """(6,) N, N m on the platform at its origin, base frame."""
        self.masses: list[tuple[float, Array]] = []
        """kg, and the position of the mass on the platform: (3,) m, platform frame."""
        self.bus_off = 0
        """Bit i: bus i is cut."""
        self.not_finite = self.hangs = self.crashes = False


FAULTS: dict[str, type[Fault]] = {}
"""`kind` of a fault -> its class, in the order of definition."""


class Fault(Section):
    """A fault that begins at an instant. Each kind states its name as `kind` in the head of its class.

    Raises ValidationError on invalid values.
    """

    effect: ClassVar[Effect | None] = None
    kind: Any = None
    at_s: Annotated[float, Field(ge=0)] = 0.0
    """Begin of the fault: time after the drives' power-up, or after `mode` is reached."""
    mode: Moment | None = None
    """Mode of the controller from whose beginning `at_s` counts."""

    def __init_subclass__(cls, kind: str | None = None, effect: Effect | None = None, **given: Any) -> None:
        """Register a kind: add it to `FAULTS`, and restrict its field `kind` to this name."""
        super().__init_subclass__(**given)
        cls.effect = effect or cls.effect
        if kind is not None:
            cls.__annotations__["kind"], cls.kind = Literal[kind], kind
            FAULTS[kind] = cls

    @property
    def lasts_ns(self) -> int:
        """Duration of the fault, ns; by default one instant."""
        return 1

    def act(self, present: Present) -> None:
        """Enter the fault's effect in `present`, for its leg if it has one."""
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
    """Of several faults of one kind the last one counts."""
    return figure


def later(ns: int, by_ms: float) -> int:
    """Several delays add up."""
    return ns + round(by_ms * 1e6)


class LastingFault(Fault):
    """A fault with the duration `for_s`."""

    for_s: Annotated[float, Field(gt=0)] | None = None
    """Duration of the fault; default: to the end of the run."""

    @property
    def lasts_ns(self) -> int:
        """Duration of the fault, ns."""
        return NEVER_NS if self.for_s is None else max(1, round(self.for_s * 1e9))


class LegFault(LastingFault):
    """A fault of one leg."""

    leg: Annotated[int, Field(ge=0, lt=LEGS)]


class Occurrence:
    """One fault in one run.

    Mutable state: its start, its random numbers, the frames that it has seen, by `Place`, and how many it has
    sent.
    """

    def __init__(self, fault: Fault, start_ns: int, generator: np.random.Generator) -> None:
        self.fault, self.start_ns, self.generator = fault, start_ns, generator
        self.frames: dict[Place, list[Frame]] = {}
        self.sent = 0

    @property
    def stop_ns(self) -> int:
        """End of the fault, ns; beyond NEVER_NS if it does not begin."""
        return self.start_ns + self.fault.lasts_ns


Place = tuple[bool, int, int]
"""Stream of frames: True if it is for the drives, the index of its bus, its identifier."""


class Passage(LastingFault):
    """A fault of frames in transit, in both directions."""

    adds: ClassVar[bool] = False
    """True if frames after the first come from an extra node, so that both ends receive them."""

    def concerns(self, frame: Frame) -> bool:
        """Check if the fault can affect this frame: its identifier and bus are the frame's or not set."""
        identifier, bus = getattr(self, "identifier", None), getattr(self, "bus", None)
        return identifier in (None, frame.id) and bus in (None, frame.bus)

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Arrivals of a frame that was due at `t_ns`: (instant, frame). Changes `own`."""
        raise NotImplementedError


class FrameFault(Passage):
    """A fault of the frames of one identifier, or of all, in both directions."""

    copies: ClassVar[int] = 1
    """Number of copies that arrive of an affected frame."""
    probability: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Probability with which a frame is affected."""
    identifier: Annotated[int, Field(ge=0)] | None = None
    """Identifier of the frames that can be affected; default: all."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random choice of frames."""

    def carry(self, t_ns: int, frame: Frame, _place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Let the fault affect a frame at random."""
        if own.generator.random() < self.probability:
            return self.strike(t_ns, frame, own.generator)
        return [(t_ns, frame)]

    def strike(self, t_ns: int, frame: Frame, _generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Arrivals of an affected frame: (instant, frame). May draw random numbers."""
        return [(t_ns, frame)] * self.copies
