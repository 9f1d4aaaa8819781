"""Any FMU as a plant: hosted in this process or in one of its own."""

from pathlib import Path

from plant_fmu.config import FmuPlant
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.spec import FmuSpec
from plant_fmu.plant import Plant


def host(spec: FmuSpec, isolation: str) -> Plant:
    """Load an FMU `in_process` or in a `child_process`. Raises PlantError."""
    return FmuHost(spec) if isolation == "in_process" else ChildHost(spec)


def fmu_plant(settings: FmuPlant, folder: Path) -> Plant:
    """Host a configured FMU; a relative path starts at `folder`, the configuration's. Raises PlantError."""
    return host(fmu_spec(settings, folder), settings.isolation)


def fmu_spec(settings: FmuPlant, folder: Path) -> FmuSpec:
    """Return what to host; a relative path starts at `folder`, the configuration's."""
    given = settings.model_dump(exclude={"type", "path", "isolation", "step_us"})
    legs = {key: tuple(given[key]) for key in ("force", "length", "rate", "brake", "wrench")}
    return FmuSpec(**given | legs, path=folder / settings.path, step_s=settings.step_us / 1e6)
