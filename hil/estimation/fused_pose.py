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

    Mutable state: the filter, the last rotation, and what the last tick's verdict was made of. `start` resets
    it.
    """

    def __init__(self, estimator: FusedEstimator, settings: FusionSettings) -> None:
        self._estimator = estimator
        self._may_lose = tuple(settings.may_lose_legs)
        self._at_once = settings.lost_at_once
        self.slip_m = settings.encoder_slip_m
        self.gap_max_s = settings.tracker_gap_max_ms * 1e-3
        self.std_max_m = settings.position_std_max_m
        self.R = np.eye(3)
        """(3, 3) of the last estimate."""
        self.contradicting: tuple[int, ...] = ()
        """Legs whose encoders have slipped and may not be lost."""
        self.position_std_m = 0.0
        """The filter's own standard deviation of the position over all directions."""
        self.alone_s = 0.0
        """With an encoder lost, since the tracker's last sample of use; else 0."""

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
        self.contradicting = tuple(leg for leg in range(LEGS) if health.slipped[leg] and not allowed[leg])
        self.position_std_m = health.position_std
        self.alone_s = health.gap_s if any(allowed) else 0.0
        if uncertain(self.position_std_m, self.std_max_m) or uncertain(self.alone_s, self.gap_max_s):
            faults |= Fault.UNCERTAIN
        tick["counted_age"] = np.where(np.array(allowed), 0, tick["age"])
        tick["unseen"] = tick["legs_used"] != _ALL_LEGS
        tick["fusion_faults"], tick["fusion_warnings"] = faults, warnings
