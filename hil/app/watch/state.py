"""State of a run for the live page: plain finite values in the units of the screen."""

from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers import build_protocol
from drivers.arrays import Rows
from drivers.signals import NEVER, Mode
from drivers.tick_columns import COLUMNS
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import platform_dict, pose_arrays
from hil.mathematics.rotations import rotation_vector
from hil.record.metrics import rotation_errors
from hil.record.mirror import Piece
from hil.record.selection import name_of

WAITS = {
    Mode.WAITING: "waits until six drives answer, are set up and off",
    Mode.IDLE: "waits for the operator's consent to move, or for the drives to become ready",
    Mode.LOADING: "tests the brakes, and builds up the holding force on them where the drives can",
    Mode.RELEASING: "waits for the brakes to open",
    Mode.APPROACH: "moves to the start of the reference",
    Mode.TRACKING: "",
    Mode.STOPPING: "slows down along the reference to rest",
    Mode.PARKING: "waits for the brakes to close",
    Mode.UNLOADING: "tests the closed brakes while the force fades",
    Mode.PARKED: "",
    Mode.FAULT: "waits for the operator: the drives are off",
    Mode.HELD: "waits for the operator: not all brakes are proven shut",
}
"""Awaited event of each mode, as text, for a controller that does not report it."""
_FOLLOWS = range(Mode.RELEASING, Mode.PARKING + 1)


def run_description(c: Configuration, log: Path, rate_Hz: float, duration_s: float | None) -> dict[str, Any]:
    """Name, geometry (joints (6, 3) m, home p (3,) m and R (9,)), limits, rate and log of a run.

    duration_s: of the reference, s; None for a reference without an end.
    """
    return robot_description(c) | {
        "name": c.name,
        "configuration": c.source,
        "log": str(log),
        "rate_Hz": rate_Hz,
        "buses": [
            f"{bus.interface}:{bus.channel}" + f", legs {', '.join(map(str, legs))}" * (len(c.bus.buses) > 1)
            for bus, legs in zip(c.bus.buses, c.bus.legs, strict=True)
        ],
        "law": c.controller.law,
        "reports_force": build_protocol(c.bus, c.drives).traits.reports_force,
        "key_needed": c.operator.deadman_s is not None,
        "stale_fault_ticks": c.limits.stale_fault_ticks,
        "reference_s": duration_s,
    }


def robot_description(c: Configuration) -> dict[str, Any]:
    """Geometry (joints (6, 3) m, home p (3,) m and R (9,)) and limits for the picture in 3D."""
    robot, platform = platform_dict(c.platform), c.platform
    p, R = pose_arrays(platform.home)
    limits = ("length_min_m", "length_max_m", "base_joint_angle_max_deg", "platform_joint_angle_max_deg")
    return {
        "base": [[float(x) for x in joint] for joint in robot["base_joints"]],
        "platform": [[float(x) for x in joint] for joint in robot["platform_joints"]],
        "home_p": p.tolist(),
        "home_R": R.ravel().tolist(),
        **{name: getattr(platform, name) for name in (*limits, "base_joint_axes", "platform_joint_axes")},
        "force_limit_N": min(c.limits.force_N, c.drives.force_limit_N),
    }


def numbers(values: ArrayLike, digits: int) -> list[float | None]:
    """Values rounded to `digits` decimals, as a flat list; None for a value that is not finite."""
    flat = np.asarray(values, np.float64).ravel().tolist()
    return [round(x, digits) if isfinite(x) else None for x in flat]


def state(piece: Piece, about: dict[str, Any], now_ns: int) -> dict[str, Any]:
    """State for the live page, from a run's shared memory. about: `run_description`; now_ns: monotonic."""
    row, figures = piece.row, piece.figures
    mode = Mode(int(row["mode"]))
    follows = mode in _FOLLOWS
    posed, led = _posed(row["p"], row["R"]), follows and _posed(row["p_d"], row["R_d"])
    heard = row["age"] < NEVER
    limit = about["force_limit_N"]
    left = np.minimum(row["q"] - about["length_min_m"], about["length_max_m"] - row["q"])  # to the nearer end
    return {
        "n": piece.number,
        "age": round((now_ns - int(figures["seen_ns"])) * 1e-9, 3),
        "t": round(int(row["t_ns"]) * 1e-9, 4),
        "tick": int(row["tick"]),
        "mode": mode.name,
        "waits": WAITS[mode],
        "path": numbers(row["reference_time_s"], 3)[0],
        "faults": [each for each in _name("faults", row["faults"]).split("|") if each != "NONE"],
        "warnings": [each for each in _name("warnings", row["warnings"]).split("|") if each != "NONE"],
        "posed": posed,
        "led": led,
        "p": numbers(row["p"], 6),
        "R": numbers(row["R"], 6),
        "r": numbers(np.degrees(rotation_vector(row["R"])), 4) if posed else [None] * 3,
        "p_d": numbers(row["p_d"], 6),
        "R_d": numbers(row["R_d"], 6),
        "r_d": numbers(np.degrees(rotation_vector(row["R_d"])), 4) if led else [None] * 3,
        "e_p": numbers(1e3 * (row["p_d"] - row["p"]), 4) if posed and led else [None] * 3,
        "e_r": numbers(1e3 * rotation_errors(row["R_d"], row["R"]), 4) if posed and led else [None] * 3,
        "legs": {
            "q": [x if h else None for x, h in zip(numbers(row["q"], 5), heard.tolist(), strict=True)],
            "margin": numbers(np.where(heard, 1e3 * left, np.nan), 2),
            "tau": numbers(row["tau"], 3),
            "given": numbers(np.where(heard & about["reports_force"], row["drive_force"], np.nan), 3),
            "share": numbers(row["tau"] / limit, 4),
            "e": numbers(1e3 * (row["q_d"] - row["q"]), 4) if led else [None] * 6,
            "state": [_name("drive_state", x) for x in row["drive_state"]],
            "fault": [_name("drive_fault", x) if x else "" for x in row["drive_fault"]],
            "age": [x if x < NEVER else None for x in row["age"].tolist()],
            "marked": _marked(row, about),
        },
        "V": numbers(row["lyapunov_share"], 4)[0],
        "bus": _name("bus_state", row["bus_state"]),
        "off": [name for bus, name in enumerate(about["buses"]) if int(row["bus_off"]) >> bus & 1],
        "late": [round(int(x) * 1e-3, 1) for x in (row["lateness_ns"], figures["late_ns"])],
        "compute": [round(int(x) * 1e-3, 1) for x in (row["compute_ns"], figures["compute_ns"])],
        **{name: int(figures[name]) for name in ("ticks", "stale", "skipped", "dropped", "waiting")},
        "capacity": int(figures["capacity"]),
        "log_bytes": int(figures["log_bytes"]),
    }


def curves(rows: Rows, about: dict[str, Any]) -> dict[str, list[Any]]:
    """Curves of the live page from kept rows (n,): time, s, and values. about: as in `state`."""
    led = np.isin(rows["mode"], _FOLLOWS)[:, None]
    unknown = np.full(len(rows), np.nan)  # the worst of a second is of all rows
    found = {
        "tau": rows["tau"],
        "e": np.where(led, 1e3 * (rows["q_d"] - rows["q"]), np.nan),
        "given": np.where((rows["age"] < NEVER) & about["reports_force"], rows["drive_force"], np.nan),
        "late": np.stack((1e-3 * rows["lateness_ns"], unknown, 1e-3 * rows["compute_ns"]), axis=1),
    }
    shown = {name: [numbers(x, 4) for x in values] for name, values in found.items()}
    return {"t": numbers(rows["tick"] / about["rate_Hz"], 4)} | shown


def _posed(p: ArrayLike, R: ArrayLike) -> bool:
    return bool(np.isfinite(p).all() and np.isfinite(R).all() and np.any(R))


def _name(column: str, value: Any) -> str:
    return name_of(COLUMNS[column], int(value))


def _marked(row: np.void, about: dict[str, Any]) -> list[str]:
    """Reasons why each leg is marked in the picture; empty for a leg in order."""
    found = []
    for leg in range(6):
        bit = 1 << leg
        names = [text for name, text in _BITS.items() if int(row[name]) & bit]
        age, fault = row["age"][leg], row["drive_fault"][leg]
        if fault:
            names.append(_name("drive_fault", fault).lower())
        if NEVER > age >= about["stale_fault_ticks"]:
            names.append("silent")
        found.append(", ".join(names))
    return found


_BITS = {
    "legs_doubted": "encoder doubted",
    "legs_moved": "moved on its brake",
    "legs_refused": "drive refuses",
}
"""Columns with one bit a leg, and the meaning of a set bit."""
