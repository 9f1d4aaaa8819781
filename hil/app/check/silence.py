"""How far legs travel from silence until they rest on their brakes, and whether that leaves the stroke."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.payload_box import corners
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.reachability import Walk
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian


class Beyond(NamedTuple):
    """Where on the path silence would drive a leg farthest into a hard end."""

    t: float
    leg: int
    travel_m: float
    """How far it may travel there until it rests on its brake."""
    free_m: float
    """How far it is from the end there."""


class Silence(NamedTuple):
    """Travel of a leg that moves at v when the bus falls silent: v T + a T^2 / 2."""

    T: float
    """drives.watchdog_ms and engage.brake_close_s, until legs rest on their brakes, s."""
    a: float
    """As on the path, or as without any force, m/s^2."""

    def travel_m(self, w: Walk) -> float:
        """Return the longest on the path: that from the top speed."""
        return float(self._travel(np.abs(w.dq)).max())

    def beyond(self, w: Walk, length_min_m: float, length_max_m: float) -> Beyond | None:
        """Return where a leg would hit a hard end; None if all stop before."""
        travel = np.stack((self._travel(np.maximum(-w.dq, 0.0)), self._travel(np.maximum(w.dq, 0.0))))
        free = np.stack((w.q - length_min_m, length_max_m - w.q))
        at = np.unravel_index(int(np.argmax(travel - free)), free.shape)
        if travel[at] <= free[at]:
            return None
        return Beyond(float(w.t[at[1]]), int(at[2]), float(travel[at]), float(free[at]))

    def _travel(self, speed: Array) -> Array:
        return speed * self.T + 0.5 * self.a * self.T**2


def silence_of(c: Configuration, w: Walk) -> Silence | None:
    """Return what silence does to the legs on a walk along the reference, whatever the payload.

    None: nothing ends it, as the drives have no watchdog that is set from here.
    """
    return reacted_to(c, w) if build_protocol(c).traits.has_watchdog else None


def reacted_to(c: Configuration, w: Walk) -> Silence:
    """Return what silence does to the legs where somebody reacts to it within drives.watchdog_ms."""
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    a = float(np.abs(w.ddq).max())
    for corner in corners(c.platform):
        platform = build_platform(corner.settings)
        model = Model(platform, leg_spin=c.platform.leg_spin)
        falls = jacobian(platform, *home) @ model.forward_dynamics(*home, still, still)
        a = max(a, float(np.abs(falls).max()))
    return Silence(1e-3 * c.drives.watchdog_ms + c.engage.closing_s, a)
