"""The speed along a path: path time that runs at a share sigma of the clock, and changes it smoothly.

With s(t) the path time, ds/dt = sigma in 0 .. 1. Its rate and the rate of that are bounded by

    |d sigma/dt| <= 1.5/T,  |d2 sigma/dt2| <= 4.5/T^2,  T = engage.stop_s,

so that a change between 0 and 1 takes T, as a controlled stop does, with its largest deceleration: 1.5/T
times the speed. No acceleration jumps. The motion is p_d(s), sigma p_d', sigma^2 p_d'' + d sigma/dt p_d':
along the path no faster than configured, and never with more than a controlled stop adds.
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
"""The tick of the last change with its path time s, sigma with its rate, 1/s, and the target; the limits of
`change`, and the period, s."""
PEAK, CURVATURE = 1.5, 4.5
"""Largest rate of sigma times T, and its largest rate times T^2."""
_LANDED = 1e-12
_CHANGES, _STEADY, _RESTS, _FULL = range(4)


@kernel(REAL, REAL, REAL, REAL, REAL, REAL)
def change(
    sigma: float, dsigma: float, target: float, limit: float, step: float, period: float
) -> tuple[float, float, float]:
    """Return by how much path time advances in the next tick, and sigma with its rate at its end.

    limit: of |d sigma/dt|, 1/s; step: by how much that may change in a tick, 1/s. In between sigma is a
    parabola.
    """
    w = next_speed(target - sigma, dsigma, limit, step, period)
    ds = period * (sigma + period * (2.0 * dsigma + w) / 6.0)
    sigma1 = min(max(sigma + 0.5 * period * (dsigma + w), 0.0), 1.0)
    if w == 0.0 and abs(target - sigma1) < _LANDED:
        sigma1 = target
    return ds, sigma1, w


@kernel(REAL, REAL, REAL, REAL, REAL)
def braking(sigma: float, dsigma: float, limit: float, step: float, period: float) -> float:
    """Return by how much path time still advances, s, when it brakes to rest from sigma and its rate."""
    s = 0.0
    for _ in range(int(8.0 / (limit * period)) + 8):  # braking from full speed takes 1.5 to 2/limit
        if sigma == 0.0 and dsigma == 0.0:
            break
        ds, sigma, dsigma = change(sigma, dsigma, 0.0, limit, step, period)
        s += ds
    return s


@helper
def time_at(override: Any, tick: int) -> float:
    """Path time in s at a tick to which it has been advanced; while sigma is constant, at any."""
    return float(override.s + override.sigma * ((tick - override.tick) * override.period))


@helper
def is_settled(override: Any) -> bool:
    """Whether sigma changes no more."""
    return bool(override.sigma == override.target and override.dsigma == 0.0)


@helper
def is_full(override: Any) -> bool:
    """Whether path time is the clock's."""
    return bool(override.sigma == 1.0 and is_settled(override))


@helper
def is_resting(override: Any) -> bool:
    """Whether path time stands still and stays so."""
    return bool(override.sigma == 0.0 and is_settled(override))


@helper
def go_on(override: Any, tick: int) -> None:
    """Go on to a tick."""
    while not is_settled(override) and override.tick < tick:
        ds, override.sigma, override.dsigma = change(
            override.sigma, override.dsigma, override.target, override.limit, override.step, override.period
        )
        override.s += ds
        override.tick += 1


@helper
def looked_ahead(override: Any, tick: int, h: float) -> tuple[float, float, float]:
    """Path time, sigma and its rate `h` seconds after a tick, as they go on by themselves."""
    sigma = min(max(override.sigma + override.dsigma * h, 0.0), 1.0)
    s = time_at(override, tick) + 0.5 * h * (override.sigma + sigma)
    return s, sigma, override.dsigma


@kernel(record(OVERRIDE))
def _phase(override: Any) -> int:
    """Return _CHANGES, or at what speed it stays: at rest, at full speed, or in between."""
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
    """Path time from tick to tick.

    Mutable state: `record`, an OVERRIDE.
    """

    def __init__(self, period_s: float, change_s: float) -> None:
        """Run at full speed. change_s > 0: T, in which sigma goes from 1 to 0."""
        self.record = context_of(
            OVERRIDE,
            limit=PEAK / change_s,
            step=CURVATURE / (change_s * change_s) * period_s,
            period=period_s,
            sigma=1.0,
            target=1.0,
        )

    sigma: float = _column("sigma", "The share of the clock, 0 .. 1.")
    dsigma: float = _column("dsigma", "Its rate, 1/s.")
    target: float = _column("target", "Where it goes, 0 .. 1.")

    def begin(self, tick: int) -> None:
        """Let path time be zero at a tick; the speed stays as it is."""
        self._from(tick, 0.0)

    def place(self, tick: int, s: float) -> None:
        """Rest at path time s (s) from a tick on."""
        self.settle(tick, 0.0)
        self._from(tick, s)

    def settle(self, tick: int, sigma: float) -> None:
        """Run at sigma from a tick on, at once."""
        self._from(tick, self.time(tick))
        self.sigma = self.target = sigma
        self.dsigma = 0.0

    def aim(self, tick: int, target: float) -> None:
        """Let sigma go to a target from a tick on, to which it has been advanced."""
        if target != self.target:
            self._from(tick, self.time(tick))
            self.target = target

    def _from(self, tick: int, s: float) -> None:
        self.record["tick"], self.record["s"] = tick, s

    @property
    def settled(self) -> bool:
        """Whether sigma changes no more."""
        return _phase(self.record) != _CHANGES

    @property
    def full(self) -> bool:
        """Whether path time is the clock's."""
        return _phase(self.record) == _FULL

    @property
    def resting(self) -> bool:
        """Whether path time stands still and stays so."""
        return _phase(self.record) == _RESTS

    def advance(self, tick: int) -> None:
        """Go on to a tick."""
        _advance(self.record, tick)

    def time(self, tick: int) -> float:
        """Return path time in s at a tick to which it has been advanced; while sigma is constant, at any."""
        return _time(self.record, tick)

    def rests_at(self, tick: int, target: float) -> float:
        """Return path time at rest, s, if sigma goes toward a target for one more tick and then to zero."""
        limits = [float(self.record[name]) for name in ("limit", "step", "period")]
        ds, sigma, dsigma = change(self.sigma, self.dsigma, target, *limits)
        return self.time(tick) + ds + braking(sigma, dsigma, *limits)

    def ahead(self, tick: int, h: float) -> tuple[float, float, float]:
        """Return path time, sigma and its rate `h` seconds after a tick, as they go on by themselves."""
        return _ahead(self.record, tick, h)
