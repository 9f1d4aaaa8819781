"""A run in lockstep whose rows stay in memory, for the rooms beside this one."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.app.configuration.configuration import Configuration
from tests.loop import bench


def run(
    configuration: Configuration, plant_of: Configuration | None = None
) -> tuple[dict[str, Any], np.ndarray]:
    """Run to the end; return the figures of the run and all rows."""
    ran = bench.run(configuration, plant_of=plant_of)
    return ran.summary, ran.rows
