"""The plant's step: how short it may be, and what it is where nobody states it."""

from collections.abc import Iterator
from math import ceil

from hil.app.configuration.yaml_positions import Path
from hil.config.loop import LoopSettings
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


def plant_steps(plant: PlantSettings | None, loop: LoopSettings, _: object) -> Iterator[tuple[Path, str]]:
    """Refuse a period that is no whole number of the plant's steps, or too many of them."""
    if plant is None:
        return
    key, period_us = step_key(plant), 1e6 / loop.rate_Hz
    step_us: float = getattr(plant.model, key)
    steps = period_us / step_us
    if steps > MOST_STEPS * (1 + 1e-9):
        message = (
            f"{steps:.3g} steps in each tick, allowed: at least {period_us / MOST_STEPS:g} "
            f"({MOST_STEPS} steps at loop.rate_Hz {loop.rate_Hz:g}), given: {step_us:g}"
        )
        yield ("plant", "model", key), message
    elif steps < 0.5 or abs(steps - round(steps)) > 1e-9 * steps:
        message = (
            f"the period is no whole number of steps, allowed: {period_us:g} us (loop.rate_Hz "
            f"{loop.rate_Hz:g}) divided by a whole number, as {period_us / ceil(steps):.12g}, given: "
            f"{step_us:g}"
        )
        yield ("plant", "model", key), message
