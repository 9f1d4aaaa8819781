"""The Plant protocol: physics behind six force inputs."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from drivers.arrays import Array


class Truth(NamedTuple):
    """What the plant knows and the controller does not, for the plant's log."""

    p: Array
    """(3,) m, platform origin in the base frame."""
    R: Array
    """(3, 3) platform to base."""
    twist: Array
    """(6,) m/s and rad/s, [v of the platform origin; omega], base frame."""
    applied_force: Array
    """(6,) N, after the drives' force lag, without friction."""


class Plant(Protocol):
    """Six legs that answer to six forces.

    Mutable state: the physics. `reset` restores the initial one exactly.
    """

    internal_step_s: float
    """Every `dt_s` given to `step` is a whole multiple of this."""

    def reset(self) -> tuple[Array, Array]:
        """Back to the initial state; return lengths (6,) m and rates (6,) m/s."""

    def step(
        self,
        force: Array,
        brake: Array,
        wrench: Array,
        dt_s: float,
    ) -> tuple[Array, Array]:
        """Hold the inputs for `dt_s` and return lengths (6,) m and rates (6,) m/s at its end.

        force (6,) N commanded, > 0 extends; brake (6,) 1 engaged, 0 released;
        wrench (6,) N, N m on the platform at its origin, base frame.
        Raises PlantError on a dt that is no multiple of the internal step or a non-finite input.
        """

    def truth(self) -> Truth | None:
        """Pose and forces now; None for a plant without a platform."""

    def applied_force(self) -> Array | None:
        """Return `applied_force` of the truth alone; None where the plant does not know it.

        It may be the plant's own memory: good until its next step.
        """

    def close(self) -> None:
        """Free what the plant holds."""
