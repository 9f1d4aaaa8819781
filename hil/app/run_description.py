"""What a run says of itself to those who watch it: plain values, fixed for the run."""

from pathlib import Path
from typing import Any

from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import platform_dict, pose_arrays


def run_description(c: Configuration, log: Path, rate_Hz: float, duration_s: float | None) -> dict[str, Any]:
    """Return name, geometry (joints (6, 3) m, home p (3,) m and R (9,)), limits, rate and log of a run.

    duration_s: of the reference; None where it has no end.
    """
    robot = platform_dict(c.platform)
    p, R = pose_arrays(c.platform.home)
    return {
        "name": c.name,
        "configuration": c.source,
        "log": str(log),
        "rate_Hz": rate_Hz,
        "bus": f"{c.bus.interface}:{c.bus.channel}",
        "law": c.controller.law,
        "base": [[float(x) for x in joint] for joint in robot["base_joints"]],
        "platform": [[float(x) for x in joint] for joint in robot["platform_joints"]],
        "home_p": p.tolist(),
        "home_R": R.ravel().tolist(),
        "length_min_m": c.platform.length_min_m,
        "length_max_m": c.platform.length_max_m,
        "force_limit_N": min(c.limits.force_N, c.drives.force_limit_N),
        "stale_fault_ticks": c.limits.stale_fault_ticks,
        "reference_s": duration_s,
    }
