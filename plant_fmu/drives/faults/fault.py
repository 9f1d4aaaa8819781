"""What faults have in common: a time, and where they act.

Times are seconds after `Nodes.start`, legs are 0..5.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import inf
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from drivers.arrays import Array
from drivers.protocol import Frame
from drivers.section import Section
from drivers.signals import LEGS


class Present:
    """The faults of drives and plant at one instant, per leg where they are a leg's."""

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.offset_m = [0.0] * LEGS
        self.frozen = [False] * LEGS
        self.lost = [False] * LEGS
        self.gain = [1.0] * LEGS
        self.silent = [False] * LEGS
        self.stuck: list[bool | None] = [None] * LEGS
        """True engaged, False released, None works."""
        self.wrench: Array = np.zeros(LEGS)
        """(6,) N, N m on the platform at its origin, base frame."""
        for fault in faults:
            fault.act(self)


class Fault(Section):
    """A fault that is present for start_s <= t < stop_s. Raises ValidationError on senseless values."""

    start_s: Annotated[float, Field(ge=0)] = 0.0
    stop_s: Annotated[float, Field(allow_inf_nan=True)] = inf

    @model_validator(mode="after")
    def _ends_after_its_start(self) -> Self:
        if not self.start_s < self.stop_s:
            raise ValueError(f"start_s < stop_s is needed, given: {self.start_s:g}, {self.stop_s:g}")
        return self

    def active(self, t_s: float) -> bool:
        """Tell whether the fault is present at this instant."""
        return self.start_s <= t_s < self.stop_s

    def act(self, present: Present) -> None:
        """Enter what the fault does to drives and plant."""


class LegFault(Fault):
    """A fault of one leg."""

    leg: Annotated[int, Field(ge=0, lt=LEGS)]


class FrameFault(Fault):
    """A fault of the frames of one identifier, or of all, in both directions."""

    probability: Annotated[float, Field(ge=0, le=1)] = 1.0
    identifier: int | None = None

    def strike(self, frame: Frame, generator: np.random.Generator) -> Frame | None:
        """Return what becomes of a frame that is struck, None if it is lost. Draws from `generator`."""
        raise NotImplementedError
