"""Estimate of the platform's pose and twist in a tick, from leg lengths and sensors."""

from math import inf

from drivers.arrays import Array, Rows
from drivers.frame_array import NO_FRAMES
from drivers.sensing.layout import no_sensors, unheard
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.estimation.pose import Estimator
from hil.loop.parts import Parts

SEARCH_S = 0.02
"""Time between two searches for the first pose."""


class Sight:
    """Fills in the estimated pose and twist of each tick.

    Mutable state: the sensors' samples, the estimator's pose, whether it has been found, searched for, or is
    due for a search, and the filter with whether it has begun.
    """

    def __init__(self, parts: Parts) -> None:
        self.parts = parts
        self.period_s = 1.0 / parts.rate_Hz
        self.estimator = Estimator(parts.platform, parts.home_p, parts.home_R)
        self.sensors = unheard(no_sensors() if parts.sensors is None else parts.sensors.tables)
        """Last samples of the sensors."""
        self._search_interval = max(LEGS, round(SEARCH_S * parts.rate_Hz))
        self.reset()

    def reset(self) -> None:
        """Restore the state before the first tick."""
        self.estimator.reset(self.parts.home_p, self.parts.home_R)
        self.sensors.forget()
        self.forget()

    def forget(self) -> None:
        """Mark the pose as unknown: it is searched for again, from the last one."""
        self.sensors.compare_again()
        self.located = self.sought = self.due = False
        """The pose has been found; it was searched for with six lengths of one tick; a search is due."""
        self.fusing = False
        """True once the filter has begun."""

    @property
    def rotation(self) -> Array:
        """Last known rotation of the platform (3, 3), platform to base."""
        fusion = self.parts.fusion if self.fusing else None
        R: Array = (self.estimator if fusion is None else fusion).record["R"]
        return R

    def locate(self, tick: Record) -> None:
        """Search for the first pose from home, and fill in the estimate of a tick before it is found.

        The search needs all six lengths of one tick, and runs at most once in SEARCH_S. Until the pose is
        found, home's stands in its place. After a RESET the search starts from the last pose that all six
        lengths agreed on.
        """
        estimator = self.estimator
        self.due = self.due or int(tick["tick"]) % self._search_interval == 0
        if self.due and not tick["age"].any():
            self.due, self.sought = False, True
            self.located = estimator.acquire(tick["q"])
        if self.located:
            self.update(tick)
            return
        tick["p"], tick["R"] = estimator.p, estimator.R
        tick["fk_residual"] = tick["condition"] = inf

    def update(self, tick: Record) -> None:
        """Fill in pose and twist of a tick from leg lengths; a leg without fresh data is extrapolated."""
        if tick["age"].any():
            tick["q"] += tick["dq"] * (tick["age"] * self.period_s)
        self.estimator.update(tick)
        if self.parts.fusion is not None:
            self.parts.fusion.begin(tick)
            self.fusing = True

    def starts(self, number: int) -> bool:
        """True while the sensors get their first frames."""
        return self.parts.sensors is not None and self.parts.sensors.starts(number)

    def set_up(self, number: int) -> Rows:
        """Frames that start the sensors in a tick, elements of FRAME."""
        sensors = self.parts.sensors
        return NO_FRAMES if sensors is None else sensors.set_up(number, self.parts.rate_Hz, self.sensors)
