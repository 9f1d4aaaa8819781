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
entry that lists (leg, figure, Occurrence); the figure, or the name of the field that has it."""


class Present:
    """All effects of faults on drives and plant at one instant; lists have one element per leg."""

    def __init__(self) -> None:
        self.own: Occurrence
        """The fault that is being entered."""
        self.offset_m = [0.0] * LEGS
        self.drifts: list[tuple[int, float, Occurrence]] = []
        """(leg, speed m/s, fault) of each encoder drift."""
        self.noise: list[tuple[int, float, Occurrence]] = []
        """(leg, standard deviation m, fault) of each encoder noise."""
        self.late_ns = [0] * LEGS
        self.scales: list[tuple[int, float, Occurrence]] = []
        """(leg, factor on the motion that its encoder counts, fault) of each scale error."""
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
        """(mass kg, position (3,) m in the platform frame) of each extra mass."""
        self.sensors: list[Occurrence] = []
        self.bus_off = 0
        """Bit i is set if bus i is off by a fault."""
        self.not_finite = self.hangs = self.crashes = False


FAULTS: dict[str, type[Fault]] = {}
"""`kind` of a fault -> its class, in the order of definition."""


class Fault(Section):
    """A fault that begins at an instant. A subclass gives its name by `kind` in its class statement.

    Raises ValidationError on invalid values.
    """

    effect: ClassVar[Effect | None] = None
    kind: Any = None
    at_s: Annotated[float, Field(ge=0)] = 0.0
    """Begin of the fault: time after the drives' power-up, or after `mode` is reached."""
    mode: Moment | None = None
    """Mode of the controller from whose beginning `at_s` counts."""

    def __init_subclass__(cls, kind: str | None = None, effect: Effect | None = None, **given: Any) -> None:
        """Register the subclass under `kind` in `FAULTS`; effect: (field, operator, value) of `Present`."""
        super().__init_subclass__(**given)
        cls.effect = effect or cls.effect
        if kind is not None:
            cls.__annotations__["kind"], cls.kind = Literal[kind], kind
            FAULTS[kind] = cls

    @property
    def lasts_ns(self) -> int:
        """Duration of the fault, ns; by default 1 ns, that is one instant."""
        return 1

    def act(self, present: Present) -> None:
        """Add the fault's effect to `present`, for its leg if it has one."""
        if self.effect is None:
            return
        (entry, join, figure), fault = self.effect, cast("Any", self)
        value = getattr(fault, figure) if isinstance(figure, str) else figure
        if join is None:
            getattr(present, entry).append((fault.leg, value, present.own))
        elif hasattr(fault, "leg"):
            entries = getattr(present, entry)
            entries[fault.leg] = join(entries[fault.leg], value)
        else:
            setattr(present, entry, join(getattr(present, entry), value))


def last(_: object, figure: object) -> object:
    """Combine two faults of one kind on a field: the later value replaces the earlier one."""
    return figure


def later(ns: int, by_ms: float) -> int:
    """Combine delays: ns plus `by_ms` milliseconds, in ns."""
    return ns + round(by_ms * 1e6)


class LastingFault(Fault):
    """A fault that lasts for `for_s` seconds."""

    for_s: Annotated[float, Field(gt=0)] | None = None
    """Duration of the fault; default: to the end of the run."""

    @property
    def lasts_ns(self) -> int:
        """Duration of the fault, ns, from `for_s`."""
        return NEVER_NS if self.for_s is None else max(1, round(self.for_s * 1e9))


class LegFault(LastingFault):
    """A fault of one leg (0..5): of its encoder, drive or brake."""

    leg: Annotated[int, Field(ge=0, lt=LEGS)]


class Occurrence:
    """One fault in one run, with its start time.

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
    """A fault of frames in transit between controller and drives, in both directions."""

    adds: ClassVar[bool] = False
    """True if frames after the first come from an extra node, so that both ends receive them."""

    def concerns(self, frame: Frame) -> bool:
        """True if the fault may affect this frame: identifier and bus match or are not configured."""
        identifier, bus = getattr(self, "identifier", None), getattr(self, "bus", None)
        return identifier in (None, frame.id) and bus in (None, frame.bus)

    def carry(self, t_ns: int, frame: Frame, place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """(arrival ns, frame) of each copy of a frame that was due at `t_ns`; empty: lost. Changes `own`."""
        raise NotImplementedError


class FrameFault(Passage):
    """A fault of all frames, or of those with one identifier, in both directions."""

    copies: ClassVar[int] = 1
    """Number of copies that arrive of an affected frame."""
    probability: Annotated[float, Field(ge=0, le=1)] = 1.0
    """Probability with which a frame is affected."""
    identifier: Annotated[int, Field(ge=0)] | None = None
    """Identifier of the frames that can be affected; default: all."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random choice of frames."""

    def carry(self, t_ns: int, frame: Frame, _place: Place, own: Occurrence) -> list[tuple[int, Frame]]:
        """Arrivals (ns, frame); the fault affects the frame with its configured probability."""
        if own.generator.random() < self.probability:
            return self.strike(t_ns, frame, own.generator)
        return [(t_ns, frame)]

    def strike(self, t_ns: int, frame: Frame, _generator: np.random.Generator) -> list[tuple[int, Frame]]:
        """Arrivals (ns, frame) of a frame that the fault affects. May draw random numbers."""
        return [(t_ns, frame)] * self.copies
