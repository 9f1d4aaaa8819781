"""What `hil check` says of the emulated brakes: their defaults are those of a platform of 1150 kg."""

from collections.abc import Iterator

import numpy as np

from hil.app.configuration.configuration import Configuration
from hil.app.reachability import Walk
from plant_fmu.config import StewartPlant


def brake_line(c: Configuration) -> list[str]:
    """Return force and times of the emulated brakes, one line; none without a plant."""
    if c.plant is None:
        return []
    drives, model = c.plant.drives, c.plant.model
    force = f"hold {model.brake_force_N:g} N each, " if isinstance(model, StewartPlant) else ""
    opens, closes = drives.brake_open_ms, drives.brake_close_ms
    return [f"emulated brakes {force}open in {opens:g} ms, close in {closes:g} ms"]


def brake_dangers(c: Configuration, w: Walk) -> Iterator[str]:
    """Yield emulated brakes that cannot hold the platform, and those that take no time."""
    if c.plant is None:
        return
    model, load_N = c.plant.model, float(np.abs(w.rest).max())
    if isinstance(model, StewartPlant) and model.brake_force_N < load_N:
        yield (
            f"plant.model.brake_force_N {model.brake_force_N:g} is below the {load_N:.3g} N that hold the "
            "platform: the emulated brakes slip under its weight; state that of your brakes"
        )
    drives = c.plant.drives
    at_once = [key for key in ("brake_open_ms", "brake_close_ms") if getattr(drives, key) == 0.0]
    if at_once:
        keys = " and ".join(f"plant.drives.{key}" for key in at_once)
        yield (
            f"{keys} 0: the emulated brakes act at once, and nothing shows what real ones cost; state what "
            "yours take"
        )
