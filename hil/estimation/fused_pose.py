"""From the filter to the cycle's Estimate: which legs may be lost, what warns and what faults."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array
from drivers.sensors import Readings
from drivers.signals import LEGS, Measurement
from hil.config import FusionSettings
from hil.estimation.fusion import Fused, FusedEstimator
from hil.safety.encoders import contradicted, excused, uncertain
from hil.signals import NO_WRENCH, Estimate, Fault, Fusion, State, Warn


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

    def estimate(
        self,
        tick: int,
        t_ns: int,
        measurement: Measurement,
        readings: Readings,
        command: Array,
        wrench: Array = NO_WRENCH,
    ) -> Estimate:
        """Return the estimate at the latching of `tick`; see `FusedEstimator.update`."""
        fused = self._estimator.update(tick, t_ns, measurement, readings, command, wrench)
        self.R = fused.R
        state = State(fused.q, fused.dq, fused.p, fused.R, fused.twist, fused.J, 0, fused.residual, wrench)
        return Estimate(state, fused.condition, 0.0, self._judge(fused, measurement))

    def _judge(self, fused: Fused, measurement: Measurement) -> Fusion:
        allowed = excused(fused.lost, self._may_lose, self._at_once)
        faults, warnings = Fault.NONE, Warn.NONE
        if any(fused.lost):
            warnings |= Warn.ENCODER
        if fused.missed:
            warnings |= Warn.SENSOR
        if contradicted(fused.slipped, allowed):
            faults |= Fault.ENCODER
        alone = fused.gap_s if any(allowed) else 0.0
        if uncertain(fused.position_std, self._std_max) or uncertain(alone, self._gap_max):
            faults |= Fault.UNCERTAIN
        return Fusion(
            used=_bits(fused.used),
            lost=_bits(fused.lost),
            slipped=_bits(fused.slipped),
            tracker=fused.tracker,
            figures=np.concatenate((fused.innovation, fused.tracker_innovation, fused.std)),
            ages=np.where(np.array(allowed), 0, measurement.age),
            warnings=warnings,
            faults=faults,
        )


def _bits(legs: Sequence[bool]) -> int:
    return sum(1 << leg for leg in range(LEGS) if legs[leg])
