"""A controlled stop: the platform stays on its path while path time slows to rest."""

from typing import Any

import numpy as np

from drivers.compiled.compiler import REAL, helper, record
from drivers.compiled.pointed import Callee, address_of, call, context_of, data_at, pointed
from hil.trajectory.path import SAMPLE, CompiledTrajectory, Trajectory, callee_of

STOP = np.dtype([("function", "<i8"), ("context", "<i8"), ("t_stop", "<f8"), ("slowing", "<f8")])


@helper
def path_time(t: float, t_stop: float, duration: float) -> tuple[float, float, float]:
    """Path time sigma(t), s, of a controlled stop, with its first and second derivative.

    Until `t_stop` sigma = t; then d sigma/dt = 1 - 3 u^2 + 2 u^3 with u = (t - t_stop)/duration. sigma comes
    to rest at t_stop + duration/2 without a jump in acceleration. The largest deceleration is 1.5/duration
    times the speed.
    """
    u = min(max((t - t_stop) / duration, 0.0), 1.0)
    if u == 0.0:
        return t, 1.0, 0.0
    sigma = t_stop + duration * u * (1.0 + u * u * (-1.0 + 0.5 * u))
    rate = 1.0 + u * u * (-3.0 + 2.0 * u)
    return sigma, rate, 6.0 * u * (u - 1.0) / duration


@helper
def slow(sample: Any, rate: float, curvature: float) -> None:
    """Scale twist and dtwist in place for path time with the given first and second derivative."""
    for i in range(6):
        along = sample.twist[i]
        sample.twist[i] = rate * along
        sample.dtwist[i] = rate * rate * sample.dtwist[i] + curvature * along


@pointed(record(STOP), REAL, record(SAMPLE))
def evaluate(stop: Any, t: float, into: Any) -> int:
    """Fill the sample at t (s) of a path that slows to rest after stop.t_stop (s)."""
    sigma, rate, curvature = path_time(t, stop.t_stop, stop.slowing)
    status: int = call(stop.function, (stop.context, sigma, address_of(into)))
    slow(into, rate, curvature)
    return status


class StoppingTrajectory(CompiledTrajectory):
    """`trajectory` until `t_stop` (s), then slowed to rest along the same path within `duration_s` > 0.

    The stop has the same clock as `trajectory`, which it can replace at t_stop without a jump in pose, twist
    or dtwist. The platform is at rest from t_stop + duration_s = `self.duration_s` on.
    """

    def __init__(self, trajectory: Trajectory, t_stop: float, duration_s: float) -> None:
        self.duration_s = float(t_stop) + float(duration_s)
        path = callee_of(trajectory)
        stop = context_of(
            STOP, function=path.address, context=path.context, t_stop=t_stop, slowing=duration_s
        )
        self.callee = Callee(evaluate.address, data_at(stop), (stop, path))
