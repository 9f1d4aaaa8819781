"""`hil identify --delay`: estimates the delay, s, from a length measurement to the resulting leg force."""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Rows
from hil.app.configuration.configuration import Configuration
from hil.lab.identify.estimators.axis_fit import Delays
from hil.lab.identify.estimators.excitation import delay_excitation
from hil.lab.identify.estimators.force_delay import Motion, force_delay
from hil.lab.identify.runs import (
    brakes_open,
    episode,
    exact_model,
    excitation_force,
    excitation_pose,
    excited_by,
    recorded_run,
    refuse_fused,
)

DURATION_S = 4.0


def excited(c: Configuration, force_N: float | None, duration_s: float | None) -> tuple[Configuration, float]:
    """Configuration that excites the loop about the held pose, else home, and its largest leg force, N.

    Raises ConfigurationError: a fused pose, a force that the limits would cut, a pose out of reach.
    """
    refuse_fused(c, c.source)
    force, pose = excitation_force(c, force_N), excitation_pose(c)
    made = delay_excitation(exact_model(c), pose, c.loop.rate_Hz, force, duration_s or DURATION_S)
    return excited_by(c, made), force


def motion_of(rows: Rows, period_s: float) -> Motion:
    """Motion of a log from the first to the last tick with open brakes. Raises LogError if never open."""
    running = np.flatnonzero(brakes_open(rows))
    rows, p, R, good = episode(rows[running[0] : running[-1] + 1])
    good = good & brakes_open(rows)
    tau, twist, rate = (np.ascontiguousarray(rows[name]) for name in ("tau", "twist", "dq"))
    return Motion(period_s, tau, p, R, twist, rate, good[1:] & good[:-1])


def delay_of_log(path: Path) -> dict[str, Any]:
    """Delay from measurement to force, ms, identified from a log of `hil run` or `hil sim`, as a summary.

    Raises LogError for another kind of file, ConfigurationError for a fused pose, IdentificationError for too
    little data.
    """
    recorded = recorded_run(path)
    refuse_fused(recorded.configuration, path)
    motion = motion_of(recorded.rows, 1.0 / recorded.rate_Hz)
    delay = force_delay(motion, exact_model(recorded.configuration))
    hold_s = 0.5 * motion.period_s
    return {
        "success": True,
        "kind": "identify",
        "log": str(path),
        **delay_figures(delay.delays, hold_s),
        "separable": delay.delays.lag_std_s > 0.0,
        "explained_percent": 100.0 * delay.explained,
        "gain": delay.gain.tolist(),
        "periods": delay.periods,
        "delay_compensation": compensation(delay.delays, hold_s),
    }


def compensation(found: Delays, hold_s: float) -> dict[str, float]:
    """Keys and values, ms, of section `controller.delay_compensation` for identified delays."""
    return {
        "bus_ms": round(1e3 * found.transport_s, 4),
        "drive_lag_ms": round(1e3 * found.lag_s, 4),
        "hold_ms": round(1e3 * hold_s, 4),
    }


def compensation_lines(keys: dict[str, float]) -> list[str]:
    """Section `controller.delay_compensation` as YAML lines to paste into a configuration."""
    values = ", ".join(f"{key}: {value:g}" for key, value in keys.items())
    return ["", "controller:", f"  delay_compensation: {{{values}}}"]


def delay_figures(found: Delays, hold_s: float) -> dict[str, float]:
    """Transport delay, lag, zero-order hold and their sum in ms, with standard deviations, by name."""
    figures = {f"{key.removesuffix('_s')}_ms": 1e3 * value for key, value in found._asdict().items()}
    return figures | {"hold_ms": 1e3 * hold_s}


def delay_rows(figures: dict[str, Any], total: str) -> list[str]:
    """Lines of text for `delay_figures`, one per delay; `total` is the remark on their sum."""
    rows = []
    for key, remark in (
        ("transport", "SYNC to feedback, computing, command: pure delay"),
        ("lag", "time constant of the drives' force loop"),
        ("hold", "half a period, by design"),
        ("total", total),
    ):
        std = figures.get(f"{key}_std_ms")
        sure = "" if std is None else f" +- {2 * std:.4f}"
        rows.append(f"  {key:12} {figures[f'{key}_ms']:8.4f}{sure:11} ms   {remark}")
    if figures["lag_std_ms"] == 0.0:
        rows.append(
            "Transport and lag could not be separated: the motion was too slow. Their sum is listed as "
            "transport; the excitation of `hil identify CONFIG` separates them."
        )
    return rows


def report(result: dict[str, Any]) -> list[str]:
    """Lines of text: the delays in ms, their uncertainty, and the YAML keys that compensate them."""
    lines = [
        "From a measurement to the resulting force (+- two standard deviations):",
        *delay_rows(result, "look-ahead of the law"),
        f"{result['periods']} periods; the commands explain {result['explained_percent']:.2f} % of the "
        "varying force; gain of each leg " + " ".join(f"{g:.3f}" for g in result["gain"]),
    ]
    worst = max(abs(g - 1.0) for g in result["gain"])
    if worst > 0.05:
        lines.append(
            f"A leg's force is {100 * worst:.0f} % off the model's: check masses and its force scale."
        )
    return [*lines, *compensation_lines(result["delay_compensation"])]
