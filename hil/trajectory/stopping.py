"""A controlled stop: the same path, its time slowed to rest."""

from drivers.arrays import Array
from drivers.compiled.compiler import REAL, VECTOR, kernel
from hil.trajectory.path import PoseSample, Trajectory


@kernel(REAL, REAL, REAL)
def path_time(t: float, t_stop: float, duration: float) -> tuple[float, float, float]:
    """Path time sigma(t) with its first and second derivative.

    Until `t_stop` sigma = t; then d sigma/dt = 1 - 3 u^2 + 2 u^3 with u = (t - t_stop)/duration: sigma comes
    to rest at t_stop + duration/2, and no acceleration jumps. The deceleration peaks at 1.5/duration times
    the speed.
    """
    u = min(max((t - t_stop) / duration, 0.0), 1.0)
    if u == 0.0:
        return t, 1.0, 0.0
    sigma = t_stop + duration * u * (1.0 + u * u * (-1.0 + 0.5 * u))
    rate = 1.0 + u * u * (-3.0 + 2.0 * u)
    return sigma, rate, 6.0 * u * (u - 1.0) / duration


@kernel(VECTOR, VECTOR, REAL, REAL)
def slowed(twist: Array, dtwist: Array, rate: float, curvature: float) -> tuple[Array, Array]:
    """Twist and its rate (6,) along a path whose time runs at `rate`: the chain rule."""
    return rate * twist, rate * rate * dtwist + curvature * twist


class StoppingTrajectory:
    """`trajectory` until `t_stop` (s), then slowed to rest along the same path within `duration_s` > 0.

    Time is that of `trajectory`: it can take its place at t_stop without a jump in pose, twist or dtwist.
    It rests for good from t_stop + duration_s = `self.duration_s` on.
    """

    def __init__(self, trajectory: Trajectory, t_stop: float, duration_s: float) -> None:
        self._trajectory = trajectory
        self._t_stop = float(t_stop)
        self._slowing = float(duration_s)
        self.duration_s = self._t_stop + self._slowing

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s); see `Trajectory`."""
        sigma, rate, curvature = path_time(t, self._t_stop, self._slowing)
        p, R, twist, dtwist = self._trajectory.sample(sigma)
        twist, dtwist = slowed(twist, dtwist, rate, curvature)
        return PoseSample(p, R, twist, dtwist)
