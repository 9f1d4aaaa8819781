"""The contract of a control law.

A law turns State and Reference into leg forces. It knows no mode, no limit, no bus and no clock; the cycle
adds the bumpless entry, safety limits the result.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from hil.config import LegSpin
from hil.config.linear_controller import LinearController
from hil.robot.geometry import Platform
from hil.signals import Effort, Reference, State
from hil.trajectory import Trajectory


class LawContext(NamedTuple):
    """What a law is built for, beside its own settings."""

    platform: Platform
    leg_spin: LegSpin
    period_s: float
    """Between two efforts."""
    trajectory: Trajectory
    """What will be tracked, for a law that computes ahead."""
    preview_s: float = 0.0
    """How far ahead of its tick the Reference is: its times are k period_s + preview_s."""
    controller: LinearController | None = None
    """For the law that runs one from a file."""


class Law(Protocol):
    """One control law.

    Contract, checked by the suite in ``tests/hil/control``: for finite input the effort is finite, or NaN
    where the law has no answer (singular J), which safety turns into a latched fault; it never raises.
    With zero error and nothing accumulated it is pure feed-forward. `reset` followed by the same inputs
    repeats to the bit. What it integrates does not grow while a limit holds back what it asks for.
    """

    def reset(self) -> None:
        """Forget everything accumulated."""

    def effort(self, state: State, reference: Reference, shortfall: Array) -> Effort:
        """Return tau (6,) N, > 0 extends, for the present State and Reference.

        shortfall (6,) N: what the drives were told at the last call less what had been asked for; 0 where
        no limit acted.
        """


def error_gains(wn_rad_s: float | list[float], damping_ratio: float) -> tuple[Array, Array]:
    """Return K_P = wn^2 (6,) 1/s^2 and K_D = 2 zeta wn (6,) 1/s of e'' + K_D e' + K_P e = 0."""
    w_n = per_leg(wn_rad_s)
    return w_n**2, 2.0 * damping_ratio * w_n


def per_leg(gain: float | list[float]) -> Array:
    """Return a gain as (6,): one number is the same for all legs."""
    return np.broadcast_to(np.asarray(gain, float), (6,)).copy()


def per_axis(position: float | list[float], rotation: float | list[float]) -> Array:
    """Return gains of position and rotation as (6,): one number is the same for all three axes."""
    return np.concatenate([np.broadcast_to(np.asarray(gain, float), (3,)) for gain in (position, rotation)])
