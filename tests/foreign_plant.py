"""An FMU from another tool: the PythonFMU of docs/examples, Python behind FMI 2.0, without units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def built(folder: Path) -> Path:
    """Build the FMU into a folder. Raises ImportError where PythonFMU is not installed."""
    from pythonfmu.builder import FmuBuilder  # noqa: PLC0415 - an extra

    return Path(FmuBuilder.build_FMU(ROOT / "docs/examples/pythonfmu_plant.py", dest=folder))


def sections(fmu: Path) -> dict[str, Any]:
    """Sections of a robot without weight, in place of the springs of configs/bench.yaml."""
    numbered = {key: [f"{key}{leg}" for leg in range(1, 7)] for key in ("force", "length", "rate", "brake")}
    circle = {"pair_half_angle_deg": 10.0}
    base = {"radius_m": 2.0, "pair_centres_deg": [0.0, 120.0, 240.0]}
    top = {"radius_m": 1.0, "pair_centres_deg": [60.0, 180.0, 300.0], "pairs_begin": "second_leg"}
    return {
        "monitor": {"friction_N": 0},
        "platform": {"base_joints_m": base | circle, "platform_joints_m": top | circle},
        "plant": {
            "model": {
                **dict.fromkeys(("mass_kg", "damping_N_s2_m2", "stiffness_N_m", "stiffness_N_m3")),
                **dict.fromkeys(("rest_length_m", "internal_step_us")),
                "type": "fmu",
                "path": str(fmu),
                "isolation": "child_process",
                "allow_execution_tool": True,
                **numbered,
                "assume_unit": {"force": "N", "length": "m", "rate": "m/s"},
                "step_us": 2500,
                "parameters": {
                    "mass": 1150.0,
                    "inertia_x": 570.0,
                    "inertia_y": 285.0,
                    "inertia_z": 285.0,
                    "base_radius": 2.0,
                    "platform_radius": 1.0,
                    "home_height": 1.0,
                    "gravity_z": 0.0,
                },
            },
            "drives": {"encoder_resolution_m": 0},
        },
    }
