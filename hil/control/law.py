"""The contract of a control law.

Rule of the room: a law turns State and Reference into leg forces. It knows no mode, no limit, no bus
and no clock; the cycle adds the bumpless entry, safety limits the result.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hil.signals import Array, Effort, Reference, State


class Law(Protocol):
    """One control law.

    Contract, checked by the suite in ``tests/hil/control``: for finite input the effort is finite, or NaN
    where the law has no answer (singular J), which safety turns into a latched fault; it never raises.
    With zero error it is pure feed-forward. `reset` followed by the same inputs repeats to the bit.
    """

    def reset(self) -> None:
        """Forget everything accumulated."""

    def effort(self, state: State, reference: Reference) -> Effort:
        """Return tau (6,) N, > 0 extends, for the present State and Reference."""


def per_leg(gain: float | list[float]) -> Array:
    """Return a gain as (6,): one number is the same for all legs."""
    return np.broadcast_to(np.asarray(gain, float), (6,)).copy()
