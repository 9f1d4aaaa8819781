"""Response of a plant to test pushes: shows coupled legs, and a fall with open brakes."""

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
    moved: Array = np.zeros((LEGS, LEGS))
    """(6, 6) m/N, change of length of leg i in this step per force in leg j; 0 if it follows a step later."""

    @property
    def uncoupled(self) -> bool | None:
        """True if each force moves one leg alone; None if some push moves no leg."""
        others = np.abs(self.mobility)
        own = others.max(axis=0)
        if not own.min() > 0.0:
            return None
        others[others.argmax(axis=0), range(LEGS)] = 0.0
        return bool(others.max() < COUPLED * own.min())


def probe(plant: Plant, force_N: float, dt_s: float) -> Probe:
    """Push each leg once by `force_N` for one step of `dt_s` s, each time from the initial state.

    The mobility (6, 6), 1/kg, is the difference to the motion without any force, per force. The plant is
    reset before each step and at the end. Raises PlantError.
    """
    open_, calm = np.zeros(LEGS), np.zeros(6)

    def changes(force: Array) -> Array:
        before = np.concatenate(plant.reset())
        result: Array = np.concatenate(plant.step(force, open_, calm, dt_s)) - before
        return result

    free = changes(np.zeros(LEGS))
    pushed = np.column_stack([(changes(force_N * one) - free) / force_N for one in np.eye(LEGS)])
    plant.reset()
    return Probe(free[LEGS:] / dt_s, pushed[LEGS:] / dt_s, pushed[:LEGS])
