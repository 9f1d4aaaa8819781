"""Opens the configured plant: a kind of plant is a section of the configuration and a row of `PLANTS`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers.section import Section
from plant_fmu.bench import Bench
from plant_fmu.config import BenchPlant, FmuPlant, StewartPlant
from plant_fmu.fmu.check import fmu_spec
from plant_fmu.fmu.child import host
from plant_fmu.plant import Plant, Robot
from plant_fmu.stewart.plant import stewart_plant

PLANTS: dict[type[Section], Callable[[Any, Robot, Path], Plant]] = {
    StewartPlant: lambda settings, robot, _: stewart_plant(settings, robot),
    BenchPlant: lambda settings, *_: Bench(settings),
    FmuPlant: lambda settings, _, folder: host(fmu_spec(settings, folder)),
}
"""Section of the configuration -> plant; arguments as for `open_plant`."""


def open_plant(model: Section, robot: Robot, folder: Path) -> Plant:
    """Open the plant of a configuration.

    model: section `plant.model`; robot: ignored by kinds that have one of their own; folder: the
    configuration's, where a relative path starts. Raises PlantError.
    """
    return PLANTS[type(model)](model, robot, folder)
