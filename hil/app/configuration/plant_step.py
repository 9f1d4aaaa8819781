"""The plant's step: how short it may be, and what it is where nobody states it."""

from math import ceil

from hil.config.running import LoopSettings
from plant_fmu.config import FmuPlant, PlantSettings

MOST_STEPS = 10_000
"""Of the plant in one tick: nobody waits for a simulation of more."""


def step_key(plant: PlantSettings) -> str:
    """Return the name of the plant's step in its section `model`."""
    return "step_us" if isinstance(plant.model, FmuPlant) else "internal_step_us"


def fitted(plant: PlantSettings, loop: LoopSettings) -> PlantSettings:
    """Return the section with a step that divides the period; as it is where the file states one."""
    key = step_key(plant)
    if key in plant.model.model_fields_set:
        return plant
    longest_us, period_us = getattr(plant.model, key), 1e6 / loop.rate_Hz
    step_us = period_us / ceil(period_us / longest_us - 1e-9)
    if abs(step_us - longest_us) <= 1e-9 * longest_us:
        return plant
    model = plant.model.model_copy(update={key: step_us})
    return plant.model_copy(update={"model": model})
