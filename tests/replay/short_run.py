"""A short run in lockstep that reaches its path: 0.17 s along it, and a stop."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import hil

SOON: dict[str, Any] = {
    "engage": {"force_ramp_s": 0.05, "brake_release_s": 0.02, "blend_s": 0.1, "stop_s": 0.3},
    "plant": {"drives": {"brake_open_ms": 20, "brake_close_ms": 20}},
}
"""Shorter waits before the path, which begins at home."""


def moved(log: Path, config: str = "virtual", **changes: Any) -> Path:
    """Record such a run to `log` and return the path; `changes` are those of `hil.sim`."""
    hil.sim(config, duration_s=0.4, log=log, plant_log=False, check_replay=False, **(SOON | changes))
    return log
