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
    return FmuSpec(
        path=folder / settings.path,
        force=tuple(settings.force),
        length=tuple(settings.length),
        rate=tuple(settings.rate),
        brake=tuple(settings.brake),
        wrench=tuple(settings.wrench),
        parameters=dict(settings.parameters),
        step_s=settings.step_us / 1e6,
        assume_unit=dict(settings.assume_unit),
        allow_execution_tool=settings.allow_execution_tool,
        memory_GB=settings.memory_GB,
    )
