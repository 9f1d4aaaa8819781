"""The speed along a path: path time that runs at a share sigma of the clock, and changes it smoothly.

With s(t) the path time, ds/dt = sigma in 0 .. 1. Its rate and the rate of that are bounded by

    |d sigma/dt| <= 1.5/T,  |d2 sigma/dt2| <= 4.5/T^2,  T = engage.stop_s,

so that a change between 0 and 1 takes T, as a controlled stop does, with its largest deceleration: 1.5/T
times the speed. No acceleration jumps. The motion is p_d(s), sigma p_d', sigma^2 p_d'' + d sigma/dt p_d':
along the path no faster than configured, and never with more than a controlled stop adds.
"""

from drivers.compiled.compiler import REAL, kernel
from hil.trajectory.live import next_speed

PEAK, CURVATURE = 1.5, 4.5
"""Largest rate of sigma times T, and its largest rate times T^2."""
_LANDED = 1e-12


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


class Override:
    """Path time from tick to tick.

    Mutable state: the tick of the last change with its path time, sigma, its rate, and the target.
    """

    def __init__(self, period_s: float, change_s: float) -> None:
        """Run at full speed. change_s > 0: T, in which sigma goes from 1 to 0."""
        self._period = period_s
        self._limit = PEAK / change_s
        self._step = CURVATURE / (change_s * change_s) * period_s
        self.sigma = self.target = 1.0
        self.dsigma = 0.0
        """1/s."""
        self.begin(0)

    def begin(self, tick: int) -> None:
        """Let path time be zero at a tick; the speed stays as it is."""
        self._tick, self._s = tick, 0.0

    def place(self, tick: int, s: float) -> None:
        """Rest at path time s (s) from a tick on."""
        self.settle(tick, 0.0)
        self._s = s

    def settle(self, tick: int, sigma: float) -> None:
        """Run at sigma from a tick on, at once."""
        self._s = self.time(tick)
        self._tick = tick
        self.sigma = self.target = sigma
        self.dsigma = 0.0

    def aim(self, tick: int, target: float) -> None:
        """Let sigma go to a target from a tick on, to which it has been advanced."""
        if target != self.target:
            self._s = self.time(tick)
            self._tick = tick
            self.target = target

    @property
    def settled(self) -> bool:
        """Whether sigma changes no more."""
        return self.sigma == self.target and self.dsigma == 0.0

    @property
    def full(self) -> bool:
        """Whether path time is the clock's."""
        return self.sigma == 1.0 and self.settled

    @property
    def resting(self) -> bool:
        """Whether path time stands still and stays so."""
        return self.sigma == 0.0 and self.settled

    def advance(self, tick: int) -> None:
        """Go on to a tick."""
        while not self.settled and self._tick < tick:
            ds, self.sigma, self.dsigma = change(
                self.sigma, self.dsigma, self.target, self._limit, self._step, self._period
            )
            self._s += ds
            self._tick += 1

    def time(self, tick: int) -> float:
        """Return path time in s at a tick to which it has been advanced; while sigma is constant, at any."""
        return self._s + self.sigma * ((tick - self._tick) * self._period)

    def rests_at(self, tick: int, target: float) -> float:
        """Return path time at rest, s, if sigma goes toward a target for one more tick and then to zero."""
        limits = self._limit, self._step, self._period
        ds, sigma, dsigma = change(self.sigma, self.dsigma, target, *limits)
        return self.time(tick) + ds + braking(sigma, dsigma, *limits)

    def ahead(self, tick: int, h: float) -> tuple[float, float, float]:
        """Return path time, sigma and its rate `h` seconds after a tick, as they go on by themselves."""
        sigma = min(max(self.sigma + self.dsigma * h, 0.0), 1.0)
        return self.time(tick) + 0.5 * h * (self.sigma + sigma), sigma, self.dsigma
