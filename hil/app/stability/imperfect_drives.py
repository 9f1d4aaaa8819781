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
from typing import NamedTuple, Self

import numpy as np

from drivers import build_protocol
from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform
from hil.app.encoder_limits import efficiencies
from hil.app.stability.instants import instants
from hil.design.stability.disturbance import Linearised, Local
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian, jacobian_rate
from hil.safety.encoder_limits import UNASKED
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

    @classmethod
    def of(cls, c: Configuration) -> Self:
        """Return those of a configuration.

        A reading that a drive sends unasked may be older than its poll by UNASKED periods, along the path.
        """
        protocol = build_protocol(c.bus, c.drives)
        read = protocol.traits.resolution.at(c.loop.rate_Hz)
        encoder_m = 0.0 if c.plant is None else c.plant.drives.encoder_resolution_m
        age_s = UNASKED / c.loop.rate_Hz if protocol.traits.unasked_s > 0.0 else 0.0
        speed, acceleration = _of_legs(build_platform(c.platform), instants(c)) if age_s else (0.0, 0.0)
        driving, back_driving = efficiencies(c)
        return cls(
            read.length + encoder_m + age_s * speed,
            read.rate + age_s * acceleration,
            read.force / back_driving,
            1.0 / (driving * back_driving) - 1.0,
            min(c.limits.force_N, c.drives.force_limit_N),
        )

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


def _of_legs(platform: Platform, path: Sequence[PoseSample]) -> tuple[Array, Array]:
    """Return the largest speed of each leg along a path, m/s, and its acceleration, m/s^2, (6,) each."""
    dq, ddq = np.zeros(6), np.zeros(6)
    for s in path:
        J = jacobian(platform, s.p, s.R)
        dq = np.maximum(dq, np.abs(J @ s.twist))
        ddq = np.maximum(ddq, np.abs(J @ s.dtwist + jacobian_rate(platform, s.p, s.R, s.twist) @ s.twist))
    return dq, ddq
