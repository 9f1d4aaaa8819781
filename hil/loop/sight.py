"""Where the platform is seen: from lengths and sensors to the estimate of a tick."""

from math import inf

from drivers.arrays import Array
from drivers.sensors import Readings, SensorProtocol
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.estimation.pose import Estimator
from hil.loop.parts import Parts
from hil.signals import TickInput

_ALL_LEGS = (1 << LEGS) - 1
AGREED_m = 1e-4
"""A fused pose that fits all six lengths so well is one from which the legs alone can go on."""
SEARCH_S = 0.02
"""From one look for the first pose to the next."""


def latched_ns(tick: Record) -> int:
    """Return when the first encoder of a tick was latched, ns."""
    woke_ns = int(tick["t_ns"]) + int(tick["lateness_ns"])
    return woke_ns + min(filter(None, tick["latch_ns"].tolist()), default=0)


class Sight:
    """Fills the estimate of each tick.

    Mutable state: the sensors' last readings, the estimator's pose, whether it has been found, was looked
    for and is to be, when each leg was last heard in time, and the filter with whether that has begun.
    """

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.period_s = 1.0 / parts.rate_Hz
        self.estimator = Estimator(parts.platform, parts.home_p, parts.home_R)
        self._search_interval = max(LEGS, round(SEARCH_S * parts.rate_Hz))
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        self.estimator.reset(self.parts.home_p, self.parts.home_R)
        self.readings = Readings()
        self.forget()

    def forget(self) -> None:
        """Look for the pose again, from the last one."""
        self.located = self.sought = self._due = False
        """The pose has been found; six lengths of one tick were looked at for it; a look is due."""
        self.in_time: list[int | None] = [None] * LEGS
        """Tick in which each leg was last heard within it, while the pose was looked for; None: in none."""
        self.fusing = False
        """Whether the filter has begun."""

    def hear(self, sensors: SensorProtocol, inp: TickInput, tick: Record) -> None:
        """Take in the sensors' samples, and count their refused frames."""
        self.readings = readings = sensors.decode(inp.frames, inp.tick, self.readings)
        if readings.wrench:
            R = self.parts.fusion.R if self.fusing and self.parts.fusion else self.estimator.R
            self.parts.wrench.hear(inp.tick, readings.wrench[-1].values, R)
        tick["sensors_rejected"] = readings.rejected
        tick["rejected"] += readings.rejected

    def locate(self, tick: Record) -> None:
        """Look for the first pose from home, and fill the estimate of a tick before which none was found.

        Until all legs have been heard and it has been found, the pose is home's. After a RESET it is looked
        for from the last one that all six lengths agreed on.
        """
        estimator = self.estimator
        self._look(int(tick["tick"]), tick["age"].tolist(), tick["q"])
        if self.located:
            self.update(tick)
            return
        tick["p"], tick["R"] = estimator.p, estimator.R
        tick["fk_residual"] = tick["condition"] = inf

    def update(self, tick: Record) -> None:
        """Fill the estimate of a tick: pose from lengths; a leg without fresh data is carried on."""
        if tick["age"].any():
            tick["q"] += tick["dq"] * (tick["age"] * self.period_s)
        self.estimator.update(tick)
        if self.parts.fusion is not None:
            self.parts.fusion.start(int(tick["tick"]), latched_ns(tick), tick["p"], tick["R"])
            self.fusing = True

    def fuse(self, tick: Record, last: Record) -> None:
        """Fill the estimate of a tick once the pose has been found, where a filter gives it."""
        fusion, estimator = self.parts.fusion, self.estimator
        assert fusion is not None
        if not self.fusing:
            self.update(tick)
            return
        fusion.estimate(tick, latched_ns(tick), self.readings, last["tau"], self.parts.wrench.last)
        if tick["legs_used"] == _ALL_LEGS and tick["fk_residual"] < AGREED_m:
            estimator.adopt(tick["p"], tick["R"])

    def _look(self, number: int, age: list[int], q: Array) -> None:
        """Look for the first pose in a tick with all six lengths, once in SEARCH_S at most."""
        self.in_time = [number if old == 0 else last for old, last in zip(age, self.in_time, strict=True)]
        self._due = self._due or number % self._search_interval == 0
        if self._due and not any(age):
            self._due, self.sought = False, True
            self.located = self.estimator.acquire(q)
