"""What faults a configuration or a command cannot have."""

from collections.abc import Iterator, Sequence
from pathlib import Path as FilePath

from hil.app.configuration.yaml_positions import Path
from plant_fmu.config import BenchPlant, PlantSettings
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.load import LOADS
from plant_fmu.faults.process import PROCESS


def platform_loads(plant: PlantSettings | None, _: FilePath | None) -> Iterator[tuple[Path, str]]:
    """Refuse a load where there is no platform to carry it."""
    if plant is None or not isinstance(plant.model, BenchPlant):
        return
    for n, fault in enumerate(plant.faults):
        if isinstance(fault, LOADS):
            message = (
                f"{fault.kind} needs a platform, and plant type bench has none: use another plant or kind"
            )
            yield ("plant", "faults", n, "kind"), message


def cannot_serve(command: str, faults: Sequence[Fault]) -> Iterator[str]:
    """Say which faults `sim` or `plant` cannot bring about, and what to do instead."""
    for n, fault in enumerate(faults):
        place = f"plant.faults[{n}]: {fault.kind}"
        if command == "sim" and isinstance(fault, PROCESS):
            yield (
                f"{place}: a simulation has no process of its own; allowed in real time: `hil plant`, "
                "`hil run --plant`"
            )
        if command == "plant" and fault.mode is not None:
            yield (
                f"{place}: mode {fault.mode}: the plant's end does not know the controller's mode; leave "
                "mode out and count at_s from the drives' power-up, or use `hil sim`"
            )
