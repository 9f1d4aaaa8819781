"""What is found of the loop of a law that linearises the robot, at each end of what is stated."""

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from drivers.arrays import Array
from hil.design.stability.sampled import Sampled
from hil.design.stability.ultimate import Ultimate


class Unknown(NamedTuple):
    """What a law's own section says that its model does not know."""

    d: float = 0.0
    """m/s^2, of each leg."""
    alpha: float = 0.0
    """Norm of Gamma - I."""


NOTHING = Unknown()


class Inertia(NamedTuple):
    """What a wrong inertia makes of the accelerations that a law asks for: Gamma = J M^-1 M_believed J^-1."""

    alpha: float = 0.0
    """Norm of Gamma - I by rows, largest."""
    alpha_2: float = 0.0
    """Spectral norm of Gamma - I, largest."""
    dominance: float = 1.0
    """Gamma_ii less the rest of its row, least."""
    definite: float = 1.0
    """Eigenvalue of the symmetric part of Gamma, least."""
    eigenvalues: tuple[float, float] = (1.0, 1.0)
    """Of Gamma, least and largest: real, as it is similar to M^-1 M_believed."""

    @classmethod
    def of(cls, Gamma: Array) -> Self:
        """Return what covers all of these (n, 6, 6)."""
        off = Gamma - np.eye(6)
        diagonal = np.diagonal(Gamma, axis1=1, axis2=2)
        rest = np.abs(Gamma).sum(axis=2) - np.abs(diagonal)
        return cls(
            float(np.abs(off).sum(axis=2).max()),
            float(np.linalg.norm(off, ord=2, axis=(1, 2)).max()),
            float((diagonal - rest).min()),
            float(np.linalg.eigvalsh(0.5 * (Gamma + Gamma.transpose(0, 2, 1))).min()),
            (float((values := np.linalg.eigvals(Gamma).real).min()), float(values.max())),
        )


class Judged(NamedTuple):
    """The loops that run, and what bounds them."""

    loops: list[Sampled]
    """Of each axis, where the bound is that of."""
    every: list[Sampled]
    """Of each axis at each end of what is stated of the inertia: those that differ."""
    bound: Ultimate | str
    inertia: Inertia = Inertia()
    bounds: tuple[tuple[list[Sampled], Ultimate], ...] = ()
    """Loops and bound at each end of what is stated of the inertia."""
    carried: str = ""
    """With what the bound is the largest, or there is none; nothing where only one thing is carried."""

    @property
    def slowest(self) -> Sampled:
        """Return the loop whose errors die out last, or one that grows fastest."""
        return slowest_of(self.every)


def slowest_of(loops: Sequence[Sampled]) -> Sampled:
    """Return the loop with the largest |z|."""
    return min(loops, key=lambda loop: loop.decay_rate)
