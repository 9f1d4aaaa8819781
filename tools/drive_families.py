"""Leg errors of each drive family: the table in docs/guides/drives.md.

    python -m tools.drive_families [FAMILY...]

Each row is `hil sim desktop` with the changes in FAMILIES. If a fault ended the run, the row shows the fault.
A log that does not replay exactly ends the program.
"""

import sys
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.app.sim.command import simulate

Changes = Mapping[str, Any]
FAMILIES: dict[str, Changes] = {
    "legs, fd": {
        "drives": {"protocol": "legs", "options": None, "transmission": None},
        "bus": {"layout": "fd"},
    },
    "legs, classic": {"drives": {"protocol": "legs", "options": None, "transmission": None}},
    "cia402, difference": {
        "drives": {
            "protocol": "cia402",
            "options": {"variant": None, "model": None, "rated_torque_Nm": 3.0, "velocity": "difference"},
            "transmission": {"counts_per_turn": 163840},  # 14 bits on the rotor, gear 10 : 1
        }
    },
    "cia402, pdo": {
        "drives": {
            "protocol": "cia402",
            "options": {"variant": None, "model": None, "rated_torque_Nm": 3.0, "velocity": "pdo"},
            "transmission": {"counts_per_turn": 163840},
            "watchdog_ms": 16,
        },
        "loop": {"rate_Hz": 312.5},
    },
    "mit, damiao DM4310": {},
    "mit, cubemars AK80-9": {"drives": {"options": {"variant": "cubemars", "model": "AK80-9"}}},
    "mit, mini_cheetah": {"drives": {"options": {"variant": "mini_cheetah", "model": None}}},
    "mit, robstride rs-02": {
        "drives": {"options": {"variant": "robstride", "model": "rs-02"}},
        "loop": {"rate_Hz": 312.5},
    },
    "odrive": {"drives": {"protocol": "odrive", "options": None}, "loop": {"rate_Hz": 312.5}},
    "moteus": {
        "drives": {
            "protocol": "moteus",
            "options": {"variant": None, "model": None, "timeout_mode": "stopped", "torque_N_m": 7},
        },
        "bus": {"layout": "fd"},
    },
}
"""Row of the table -> changes to configs/desktop.yaml."""
NO_FRICTION = {"viscous_friction_N_s_m": 0, "coulomb_friction_N": 0}
NO_LOSS = {"efficiency": 1.0, "back_driving_efficiency": 1.0}


def merged(*changes: Changes) -> dict[str, Any]:
    """Merge several configuration changes, section by section; later changes win."""
    whole: dict[str, Any] = {}
    for change in changes:
        for key, value in change.items():
            both = isinstance(value, Mapping) and isinstance(whole.get(key), Mapping)
            whole[key] = merged(whole[key], value) if both else value
    return whole


def simulated(changes: Changes) -> dict[str, Any]:
    """Simulate `desktop` with changes; return the summary. Raises RuntimeError if the replay is not exact."""
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    with TemporaryDirectory() as folder:
        summary = simulate(loads(with_changes(text, changes), "desktop"), log=Path(folder) / "run.mcap")
    if not summary["replay"]["exact"]:
        raise RuntimeError(f"desktop with {changes}: replay {summary['replay']}")
    return summary


def errors(summary: Mapping[str, Any], per_mm: float = 1.0, digits: int = 3) -> str:
    """Text of rms and peak leg error in mm times `per_mm`, or of the fault that ended the run."""
    if not summary["success"]:
        return str(summary["trouble"]).split(" (")[0]
    tracking = summary["tracking"]
    return ", ".join(
        f"{per_mm * tracking[key]:.{digits}f}" for key in ("rms_leg_error_mm", "peak_leg_error_mm")
    )


def desktop(*families: str) -> None:
    """Print the table of leg errors for all drive families, or for the given ones."""
    print("| family | rate, Hz | bus, % | shipped, mm | no friction, um | nor losses, um |")
    print("|---|---|---|---|---|---|")
    smooth = {"plant": {"model": NO_FRICTION}}
    for name, changes in FAMILIES.items():
        if families and name not in families:
            continue
        given = simulated(changes)
        lossless = {} if name.startswith("legs") else {"drives": {"transmission": NO_LOSS}}
        without = [simulated(merged(changes, smooth, loss)) for loss in ({}, lossless)]
        cells = [f"{given['rate_Hz']:g}", f"{given['bus_load_percent']:.1f}", errors(given)]
        cells += [errors(each, 1e3, 1) for each in without]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    desktop(*sys.argv[1:])
