"""Speed override along a path: path time runs at a share sigma of real time, and sigma changes smoothly.

With path time s(t), ds/dt = sigma in 0 .. 1. Two bounds apply to sigma:

    |d sigma/dt| <= 1.5/T,  |d2 sigma/dt2| <= 4.5/T^2,  T = engage.stop_s,

A change between 0 and 1 takes T and has the largest deceleration of a controlled stop: 1.5/T times the
speed. The acceleration does not jump. The motion is p_d(s), sigma p_d', sigma^2 p_d'' + d sigma/dt p_d':
the path speed never exceeds the configured one, and the added acceleration never exceeds a controlled stop's.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, REAL, helper, kernel, record
from drivers.compiled.pointed import context_of
from hil.trajectory.live import next_speed

OVERRIDE = np.dtype(
    [
        ("tick", "<i8"),
        ("s", "<f8"),
        ("sigma", "<f8"),
        ("dsigma", "<f8"),
        ("target", "<f8"),
        ("limit", "<f8"),
        ("step", "<f8"),
        ("period", "<f8"),
    ]
)
"""Layout of the state: tick of the last change with path time s, sigma with its rate, 1/s, and the target;
limits of `change`; the period, s."""
PEAK, CURVATURE = 1.5, 4.5
"""Largest first derivative of sigma times T, largest second derivative times T^2."""
_LANDED = 1e-12
_CHANGES, _STEADY, _RESTS, _FULL = range(4)


@kernel(REAL, REAL, REAL, REAL, REAL, REAL)
def change(
    sigma: float, dsigma: float, target: float, limit: float, step: float, period: float
) -> tuple[float, float, float]:
    """Advance of path time, s, in the next tick, and sigma with its rate at the end of the tick.

    limit: of |d sigma/dt|, 1/s; step: its largest change per tick, 1/s. Within a tick sigma is a parabola.
    """
    w = next_speed(target - sigma, dsigma, limit, step, period)
    ds = period * (sigma + period * (2.0 * dsigma + w) / 6.0)
    sigma1 = min(max(sigma + 0.5 * period * (dsigma + w), 0.0), 1.0)
    if w == 0.0 and abs(target - sigma1) < _LANDED:
        sigma1 = target
    return ds, sigma1, w


@kernel(REAL, REAL, REAL, REAL, REAL)
def braking(sigma: float, dsigma: float, limit: float, step: float, period: float) -> float:
    """Advance of path time, s, until sigma has come from its present value and rate to 0."""
    s = 0.0
    for _ in range(int(8.0 / (limit * period)) + 8):  # braking from full speed takes 1.5 to 2/limit
        if sigma == 0.0 and dsigma == 0.0:
            break
        ds, sigma, dsigma = change(sigma, dsigma, 0.0, limit, step, period)
        s += ds
    return s


@helper
def time_at(override: Any, tick: int) -> float:
    """Path time, s, at the tick of the last `advance`; while sigma is constant, at any tick."""
    return float(override.s + override.sigma * ((tick - override.tick) * override.period))


@helper
def is_settled(override: Any) -> bool:
    """True if the speed share sigma is constant: no change is under way."""
    return bool(override.sigma == override.target and override.dsigma == 0.0)


@helper
def is_full(override: Any) -> bool:
    """True if path time runs at full speed (sigma = 1), and sigma is constant."""
    return bool(override.sigma == 1.0 and is_settled(override))


@helper
def is_resting(override: Any) -> bool:
    """True if path time stands still (sigma = 0), and sigma is constant."""
    return bool(override.sigma == 0.0 and is_settled(override))


@helper
def go_on(override: Any, tick: int) -> None:
    """Advance path time and the speed share sigma to a tick."""
    while not is_settled(override) and override.tick < tick:
        ds, override.sigma, override.dsigma = change(
            override.sigma, override.dsigma, override.target, override.limit, override.step, override.period
        )
        override.s += ds
        override.tick += 1


@helper
def looked_ahead(override: Any, tick: int, h: float) -> tuple[float, float, float]:
    """Path time, s, speed share sigma and its rate, 1/s, extrapolated to `h` seconds after a tick."""
    sigma = min(max(override.sigma + override.dsigma * h, 0.0), 1.0)
    s = time_at(override, tick) + 0.5 * h * (override.sigma + sigma)
    return s, sigma, override.dsigma


@kernel(record(OVERRIDE))
def _phase(override: Any) -> int:
    """_CHANGES while sigma changes, else _RESTS at 0, _FULL at 1, or _STEADY between."""
    if is_resting(override):
        return _RESTS
    if is_full(override):
        return _FULL
    return _STEADY if is_settled(override) else _CHANGES


_time = kernel(record(OVERRIDE), INTEGER)(time_at)
_advance = kernel(record(OVERRIDE), INTEGER)(go_on)
_ahead = kernel(record(OVERRIDE), INTEGER, REAL)(looked_ahead)


def _column(name: str, meaning: str) -> Any:
    def read(override: "Override") -> float:
        return float(override.record[name])

    def write(override: "Override", value: float) -> None:
        override.record[name] = value

    return property(read, write, doc=meaning)


class Override:
    """Path time of a run from tick to tick, at an adjustable share sigma, 0 .. 1, of real time.

    Mutable state: `record`, an OVERRIDE.
    """

    def __init__(self, period_s: float, change_s: float) -> None:
        """Start at full speed, sigma = 1. change_s > 0: T, the time in which sigma changes from 1 to 0."""
        self.record = context_of(
            OVERRIDE,
            limit=PEAK / change_s,
            step=CURVATURE / (change_s * change_s) * period_s,
            period=period_s,
            sigma=1.0,
            target=1.0,
        )

    sigma: float = _column("sigma", "Rate of path time, as a share of real time, 0 .. 1.")
    dsigma: float = _column("dsigma", "Rate of sigma, 1/s.")
    target: float = _column("target", "Target of sigma, 0 .. 1.")

    def begin(self, tick: int) -> None:
        """Set path time to zero at a tick, without a change of the speed share sigma."""
        self._from(tick, 0.0)

    def place(self, tick: int, s: float) -> None:
        """Stand still at path time s (s) from a tick on."""
        self.settle(tick, 0.0)
        self._from(tick, s)

    def settle(self, tick: int, sigma: float) -> None:
        """Set the speed share sigma, 0 .. 1, at a tick at once, without a ramp."""
        self._from(tick, self.time(tick))
        self.sigma = self.target = sigma
        self.dsigma = 0.0

    def aim(self, tick: int, target: float) -> None:
        """Set the target, 0 .. 1, of the speed share sigma, from a tick that `advance` has reached."""
        if target != self.target:
            self._from(tick, self.time(tick))
            self.target = target

    def _from(self, tick: int, s: float) -> None:
        self.record["tick"], self.record["s"] = tick, s

    @property
    def settled(self) -> bool:
        """True while the speed share sigma is constant."""
        return _phase(self.record) != _CHANGES

    @property
    def full(self) -> bool:
        """True while path time runs at full speed (sigma = 1), and sigma is constant."""
        return _phase(self.record) == _FULL

    @property
    def resting(self) -> bool:
        """True while path time stands still (sigma = 0), and sigma is constant."""
        return _phase(self.record) == _RESTS

    def advance(self, tick: int) -> None:
        """Advance path time and the speed share sigma to a tick."""
        _advance(self.record, tick)

    def time(self, tick: int) -> float:
        """Path time, s, at the tick of the last `advance`; while sigma is constant, at any tick."""
        return _time(self.record, tick)

    def rests_at(self, tick: int, target: float) -> float:
        """Path time, s, of the stop if sigma moves towards `target` for one more tick and then to zero."""
        limits = [float(self.record[name]) for name in ("limit", "step", "period")]
        ds, sigma, dsigma = change(self.sigma, self.dsigma, target, *limits)
        return self.time(tick) + ds + braking(sigma, dsigma, *limits)

    def ahead(self, tick: int, h: float) -> tuple[float, float, float]:
        """Path time, s, speed share sigma and its rate, 1/s, extrapolated to `h` seconds after a tick."""
        return _ahead(self.record, tick, h)
