"""What the drives add to the disturbance of a loop: the steps of their frames, the losses of a transmission.

A force F is sent as F loss(rate read) by the motor, in steps, and acts as that over loss(true rate), see
`drivers.transmission`. Where both rates have the same sign beyond `full_loss_m_s` the losses cancel. Where a
leg turns round they need not: rates are read in steps and some milliseconds late. So a leg may be off by

::

    |dF| <= rho |F| + step / eta_b,     rho = 1 / (eta_d eta_b) - 1

at any time, and its axes by P dF, P the accelerations per force. |F| is either that of the reference and of
P^-1 Gamma u, or limits.force_N, beyond which safety sends none: each gives a bound.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.design.stability.disturbance import Linearised, Local
from hil.trajectory.path import PoseSample


class Disturbed(NamedTuple):
    """What the axes are disturbed by."""

    d: Array
    """(6,) m/s^2 or rad/s^2."""
    lost: Array
    """(6, 6), share of |u| that is beside it."""


class Drives(NamedTuple):
    """Six drives, each array (6,)."""

    length: Array
    """m, by which a length may be read wrong: by the drive's steps, the encoder's, and by its age."""
    rate: Array
    """m/s, of a rate."""
    force: Array
    """N at the leg, by the steps of a command."""
    loss: Array
    """rho, share of a force by which losses may be made up for wrongly."""
    most_N: float
    """No force is larger."""

    @property
    def stepped(self) -> bool:
        """Tell whether what is read or sent has steps."""
        return bool(np.any([self.length, self.rate, self.force]))

    def disturb(self, linearised: Linearised, path: Sequence[PoseSample], found: Local) -> list[Disturbed]:
        """Return what the axes are disturbed by along a path, by either bound of the forces they lose.

        found: the robot at each sample of the path.
        """
        P = np.abs(found.per_force)
        steps = (P @ self.force).max(axis=0)
        if not self.loss.any():
            return [Disturbed(steps, np.zeros((6, 6)))]
        tau = np.abs(linearised.along_reference(path)[0])
        back = np.abs(np.linalg.solve(found.per_force, found.Gamma))
        by_path = np.einsum("nij,nj->ni", P, self.loss * tau).max(axis=0)
        by_u = (P @ (self.loss[:, None] * back)).max(axis=0)
        at_most = (P @ (self.loss * self.most_N)).max(axis=0)
        return [Disturbed(steps + by_path, by_u), Disturbed(steps + at_most, np.zeros((6, 6)))]
