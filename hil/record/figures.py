"""Summary figures and a picture of a run, from its recorded rows."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.files import whole_file
from drivers.signals import LEGS, BusState, Fault, Mode, Warn
from drivers.tick_columns import COLUMNS
from hil.record.metrics import rotation_errors
from hil.record.selection import name_of
from hil.signals import explain


def figures(rows: Rows) -> dict[str, Any]:
    """Figures of a run: tracking errors in mm, forces in N, wake-up lateness in us, tick counts.

    The errors cover ticks in mode TRACKING only. `rows` has dtype ROW, one element per tick.
    """
    tracking = rows["mode"] == Mode.TRACKING
    held = rows["mode"] == Mode.HELD
    powered = (rows["mode"] >= Mode.LOADING) & (rows["mode"] <= Mode.UNLOADING) | held
    faults = int(np.bitwise_or.reduce(rows["faults"]))
    result: dict[str, Any] = {
        "ticks": len(rows),
        "duration_s": float((rows["t_ns"][-1] - rows["t_ns"][0]) * 1e-9) if len(rows) else 0.0,
        "final_mode": name_of(COLUMNS["mode"], int(rows["mode"][-1])) if len(rows) else None,
        "faults": [str(fault.name) for fault in Fault if faults & fault],
        "tracking": {"ticks": int(tracking.sum())}
        | errors({name: rows[name][tracking] for name in FOLLOWED}),
        "peak_force_N": float(np.abs(rows["tau"]).max(initial=0.0)),
        "limited_ticks": limited_ticks(rows),
        "pushes": pushes(rows),
        "wake_up_us": _percentiles(rows["lateness_ns"] / 1e3),
        "compute_us": _percentiles(rows["compute_ns"][1:] / 1e3),
        "stale_ticks": int(np.count_nonzero((rows["age"] > 0).any(axis=1) & powered)),
        "skipped_ticks": int(rows["skipped"][1:].sum()),
        "rejected_frames": int(rows["rejected"].sum()),
        "dropped_ticks": int(rows["recorder_dropped"][-1]) if len(rows) else 0,
    }
    troubles = bus_troubles(rows)
    if any(troubles.values()):
        result["bus"] = troubles
    if len(rows) and (rows["setpoints_taken"][-1] or rows["setpoints_refused"][-1]):
        result["setpoints"] = {
            "taken": int(rows["setpoints_taken"][-1]),
            "refused": int(rows["setpoints_refused"][-1]),
            "why": explain(int(np.bitwise_or.reduce(rows["setpoint_refusal"]))) or None,
        }
    if np.isfinite(rows["lyapunov"]).any():
        result["certificate"] = certificate(rows)
    if tracking.any():
        result["first_motion_s"] = float((rows["t_ns"][tracking][0] - rows["t_ns"][0]) * 1e-9)
    return result


def bus_troubles(rows: Rows) -> dict[str, int]:
    """Counts of bus problems: error frames, losses, and entries of the CAN controller into error states.

    An error state counts if that of the previous tick was better; a jump to bus-off counts as bus-off only.
    """
    state = rows["bus_state"]
    before = np.concatenate([[BusState.UNKNOWN], state])[:-1]
    levels = {"error_warning": BusState.WARNING, "error_passive": BusState.PASSIVE, "bus_off": BusState.OFF}
    return {
        "error_frames": int(rows["bus_errors"].sum()),
        "frames_not_taken": int(rows["sends_failed"].sum()),
        "receptions_lost": int(rows["bus_overflow"].sum()),
        "off_ticks": int(np.count_nonzero(rows["bus_off"])),
        **{
            name: int(np.count_nonzero((state == level) & (before < level))) for name, level in levels.items()
        },
    }


def limited_ticks(rows: Rows) -> dict[str, int]:
    """Number of ticks at which each force limit reduced a force, by the name of its warning."""
    limits = (Warn.FORCE_LIMIT, Warn.FORCE_STEP, Warn.FORCE_WINDOW)
    return {str(w.name): int(np.count_nonzero(rows["warnings"] & w)) for w in limits}


def pushes(rows: Rows) -> dict[str, Any] | None:
    """Number of force pulses that probed a leg (column probe_force), in total and by leg, and the largest, N.

    None if no leg was probed, or if the log is older than the column.
    """
    force = np.nan_to_num(np.abs(rows["probe_force"]))
    if not force.any():
        return None
    pushed = np.concatenate([np.zeros((2, LEGS), np.bool_), force > 0.0])
    began = pushed[2:] & ~pushed[1:-1] & ~pushed[:-2]  # a push that changes direction may be 0 for a tick
    return {"count": int(began.sum()), "largest_N": float(force.max()), "legs": began.sum(axis=0).tolist()}


def certificate(rows: Rows) -> dict[str, Any]:
    """Figures of the Lyapunov monitor: largest V, its bound there, largest share of the bound, alarms.

    The share is that of sqrt(V) on the worst axis, so it may be closer to 100 % than the sum over all axes.
    """
    V, bound, share = (rows[name] for name in ("lyapunov", "lyapunov_bound", "lyapunov_share"))
    alarm = (rows["warnings"] & Warn.CERTIFICATE) > 0
    watched = np.isfinite(share)
    result: dict[str, Any] = {"peak_V_m2_s4": float(np.nanmax(V)), "watched_ticks": int(watched.sum())}
    if watched.any():
        peak = int(np.nanargmax(np.where(watched, V, np.nan)))
        result |= {
            "bound_at_peak_m2_s4": float(bound[peak]),
            "largest_share_percent": 100.0 * float(share[watched].max()),
        }
    late = int(np.count_nonzero((rows["mode"] == Mode.TRACKING) & ((rows["warnings"] & Warn.STALE) > 0)))
    if late:
        result["without_its_premise"] = f"feedback was late in {late} ticks: no error bound holds there"
    return result | {"alarms": int(np.count_nonzero(alarm[1:] & ~alarm[:-1]) + alarm[0])}


def pose_errors(rows: Rows | Mapping[str, Array]) -> tuple[Array, Array]:
    """Position errors (n, 3) mm and rotation vectors (n, 3) deg from pose to reference, base frame."""
    return 1e3 * (rows["p_d"] - rows["p"]), np.rad2deg(rotation_errors(rows["R_d"], rows["R"]))


FOLLOWED = ("q_d", "q", "p_d", "p", "R_d", "R", "tau", "dq")
"""Columns that the function `errors` reads."""


def errors(rows: Rows | Mapping[str, Array]) -> dict[str, float]:
    """Tracking errors (mm, deg), peak force (N), peak leg rate (m/s) over all rows; empty without rows."""
    if not len(rows["q"]):
        return {}
    e_mm = (rows["q_d"] - rows["q"]) * 1e3
    p_mm, r_deg = pose_errors(rows)
    return {
        "peak_leg_error_mm": float(np.abs(e_mm).max()),
        "rms_leg_error_mm": float(np.sqrt((e_mm**2).mean())),
        "peak_position_error_mm": float(np.linalg.norm(p_mm, axis=1).max()),
        "peak_rotation_error_deg": float(np.linalg.norm(r_deg, axis=1).max()),
        "peak_force_N": float(np.abs(rows["tau"]).max()),
        "peak_leg_rate_m_s": float(np.abs(rows["dq"]).max()),
    }


def _percentiles(values: Array) -> dict[str, float]:
    if not len(values):
        return {}
    p50, p99 = np.percentile(values, [50, 99])
    return {"p50": float(p50), "p99": float(p99), "max": float(values.max())}


def picture(rows: Rows, path: Path, title: str) -> Path:
    """Draw leg errors, leg forces, pose and wake-up lateness of a run into a PNG file."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    figure = Figure(figsize=(12, 8), layout="constrained")
    (path_axes, error_axes), (force_axes, wake_axes) = figure.subplots(2, 2)
    t = (rows["t_ns"] - rows["t_ns"][0]) * 1e-9
    moving = rows["mode"] == Mode.TRACKING
    for i, name in enumerate(COLUMNS["p"].elements):
        path_axes.plot(t, rows["p"][:, i], label=name)
        path_axes.plot(t, np.where(moving, rows["p_d"][:, i], np.nan), "k:", linewidth=0.8)
    path_axes.set_title("platform origin; dotted: reference", loc="left")
    path_axes.set_ylabel(COLUMNS["p"].unit)
    path_axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, handlelength=1.2)
    e_mm = np.where(moving[:, None], (rows["q_d"] - rows["q"]) * 1e3, np.nan)
    error_axes.plot(t, e_mm, linewidth=0.8)
    error_axes.set(title="leg error q_d - q while tracking", ylabel="mm")
    force_axes.plot(t, rows["tau"], linewidth=0.8)
    force_axes.set(title="leg forces sent", ylabel="N", xlabel="s")
    lateness = np.sort(rows["lateness_ns"] / 1e3)
    share = 1.0 - np.arange(len(lateness)) / len(lateness)
    wake_axes.semilogy(lateness, share)
    wake_axes.set(title="wake-ups later than", xlabel="us", ylabel="share of ticks")
    for axes in (path_axes, error_axes, force_axes, wake_axes):
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=100)
    return path
