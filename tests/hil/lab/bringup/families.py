"""A desktop hexapod with every drive family, as changes of configs/desktop.yaml."""

from functools import cache
from importlib import resources
from typing import Any

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads

_COUNTS = {"counts_per_turn": 163840}
_402 = {"variant": None, "model": None, "rated_torque_Nm": 3.0}
FAMILIES: dict[str, dict[str, Any]] = {
    "legs_fd": {
        "drives": {"protocol": "legs", "options": None, "transmission": None},
        "bus": {"layout": "fd"},
    },
    "legs_classic": {"drives": {"protocol": "legs", "options": None, "transmission": None}},
    "cia402_difference": {
        "drives": {
            "protocol": "cia402",
            "options": _402 | {"velocity": "difference"},
            "transmission": _COUNTS,
            "watchdog_ms": 20,
        }
    },
    "cia402_pdo": {
        "drives": {
            "protocol": "cia402",
            "options": _402 | {"velocity": "pdo"},
            "transmission": _COUNTS,
            "watchdog_ms": 16,
        },
        "loop": {"rate_Hz": 312.5},
    },
    "damiao": {},
    "cubemars": {"drives": {"options": {"variant": "cubemars", "model": "AK80-9"}}},
    "mini_cheetah": {"drives": {"options": {"variant": "mini_cheetah", "model": None}}},
    "robstride": {
        "drives": {"options": {"variant": "robstride", "model": "rs-02"}},
        "loop": {"rate_Hz": 312.5},
    },
    "odrive": {"drives": {"protocol": "odrive", "options": None}, "loop": {"rate_Hz": 312.5}},
    "moteus_stopped": {
        "drives": {
            "protocol": "moteus",
            "options": {"variant": None, "model": None, "timeout_mode": "stopped", "torque_N_m": 7},
        },
        "bus": {"layout": "fd"},
    },
    "moteus_zero_velocity": {
        "drives": {
            "protocol": "moteus",
            "options": {"variant": None, "model": None, "timeout_mode": "zero_velocity", "torque_N_m": 7},
        },
        "bus": {"layout": "fd"},
        "reactions": {"silence": "damp"},
    },
}


@cache
def family(name: str) -> Configuration:
    """Configuration of a machine with this drive family."""
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    return loads(with_changes(text, FAMILIES[name]), name)
