"""From the filter to the estimate of a tick: which legs may be lost, what warns and what faults."""

import numpy as np

from drivers.arrays import Array
from drivers.sensors import Readings
from drivers.signals import LEGS, Fault, Warn
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.estimation.fusion import FusedEstimator, Health
from hil.safety.encoders import contradicted, excused, uncertain

_ALL_LEGS = (1 << LEGS) - 1


class PoseFusion:
    """The filter with its limits.

    Mutable state: the filter, the last rotation, which encoders have slipped. `start` resets it.
    """

    def __init__(self, estimator: FusedEstimator, settings: FusionSettings) -> None:
        self._estimator = estimator
        self._may_lose = tuple(settings.may_lose_legs)
        self._at_once = settings.lost_at_once
        self._gap_max = settings.tracker_gap_max_ms * 1e-3
        self._std_max = settings.position_std_max_m
        self.R = np.eye(3)
        """(3, 3) of the last estimate."""

    @property
    def slipped(self) -> tuple[int, ...]:
        """Legs whose encoders have slipped."""
        return tuple(leg for leg in range(LEGS) if self._estimator.slipped[leg])

    def start(self, tick: int, t_ns: int, p: Array, R: Array) -> None:
        """Begin at rest at a pose that the legs have just given."""
        self._estimator.start(tick, t_ns, p, R)
        self.R = R

    def estimate(self, tick: Record, t_ns: int, readings: Readings, command: Array, wrench: Array) -> None:
        """Fill estimate and fusion of a tick; see `FusedEstimator.update`."""
        self._judge(tick, self._estimator.update(tick, t_ns, readings, command, wrench))
        self.R = tick["R"]

    def _judge(self, tick: Record, health: Health) -> None:
        allowed = excused(health.lost, self._may_lose, self._at_once)
        faults, warnings = Fault.NONE, Warn.NONE
        if any(health.lost):
            warnings |= Warn.ENCODER
        if health.missed:
            warnings |= Warn.SENSOR
        if contradicted(health.slipped, allowed):
            faults |= Fault.ENCODER
        alone = health.gap_s if any(allowed) else 0.0
        if uncertain(health.position_std, self._std_max) or uncertain(alone, self._gap_max):
            faults |= Fault.UNCERTAIN
        tick["counted_age"] = np.where(np.array(allowed), 0, tick["age"])
        tick["unseen"] = tick["legs_used"] != _ALL_LEGS
        tick["fusion_faults"], tick["fusion_warnings"] = faults, warnings
