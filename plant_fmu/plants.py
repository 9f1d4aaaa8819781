"""Opens the configured plant; a kind of plant is an entry point of the group `hil.plants`."""

from pathlib import Path
from pkgutil import resolve_name

from plant_fmu.config import BenchPlant, FmuPlant, PlantModel, StewartPlant
from plant_fmu.plant import Plant, Robot


def open_plant(model: PlantModel, robot: Robot, folder: Path) -> Plant:
    """Open the plant of a configuration.

    model: section `plant.model`; robot: ignored by kinds that have one of their own; folder: the
    configuration's, where a relative path starts. Raises PlantError.
    """
    plant: Plant = resolve_name(model.opens)(model, robot, folder)
    return plant


def stewart(model: StewartPlant, robot: Robot, _: Path) -> Plant:
    """Open our FMU."""
    from plant_fmu.stewart.plant import stewart_plant

    return stewart_plant(model, robot)


def bench(model: BenchPlant, *_: object) -> Plant:
    """Open six uncoupled legs."""
    from plant_fmu.bench import Bench

    return Bench(model)


def fmu(model: FmuPlant, _: Robot, folder: Path) -> Plant:
    """Open the user's FMU."""
    from plant_fmu.fmu.check import fmu_spec
    from plant_fmu.fmu.child import host

    return host(fmu_spec(model, folder))
