"""Response of a plant to pushes, which shows if its legs are coupled and if it falls without brakes."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS
from plant_fmu.plant import Plant

COUPLED = 1e-3
"""Legs of a platform move each other by tens of percent, uncoupled legs only by rounding errors."""


class Probe(NamedTuple):
    """Response of a plant to small pushes from its initial state, brakes open."""

    acceleration: Array
    """(6,) m/s^2, accelerations of the legs without any force."""
    mobility: Array
    """(6, 6) 1/kg, acceleration of leg i per force in leg j."""

    @property
    def uncoupled(self) -> bool | None:
        """True if each leg moves by its own force alone; None if pushes move no leg."""
        own = np.abs(np.diag(self.mobility))
        if not own.min() > 0.0:
            return None
        others = np.abs(self.mobility - np.diag(np.diag(self.mobility)))
        return bool(others.max() < COUPLED * own.min())


def probe(plant: Plant, force_N: float, dt_s: float) -> Probe:
    """Push each leg once by `force_N` for one step of `dt_s` s, each time from the initial state.

    The mobility is the difference to the motion without any force. The plant is reset before each step and at
    the end. Raises PlantError.
    """
    open_, calm = np.zeros(LEGS), np.zeros(6)

    def accelerations(force: Array) -> Array:
        _, before = plant.reset()
        _, after = plant.step(force, open_, calm, dt_s)
        result: Array = (after - before) / dt_s
        return result

    free = accelerations(np.zeros(LEGS))
    pushed = [accelerations(force_N * np.eye(LEGS)[j]) for j in range(LEGS)]
    plant.reset()
    mobility = np.column_stack([(a - free) / force_N for a in pushed])
    return Probe(free, mobility)
