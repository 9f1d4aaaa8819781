"""`hil run`: the daemon on the controller PC, in real time, against drives or the plant that it starts."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any

import numpy as np

from drivers.bus import Bus
from drivers.bustime import BusBudget
from drivers.errors import LogError, RunError
from hil.app.compose import attachments, build_cycle, build_scene, bus_budget, feedback_window_s
from hil.app.configuration import Configuration
from hil.app.output import console, log_path
from hil.app.replay import replay_log
from hil.app.supervise import SupervisedPlant
from hil.clock import Deadlines, RealTime, fifo_allowed, holdable_rate, real_time, resident_MB
from hil.daemon import Ending, OperatorPanel, run
from hil.log import Log
from hil.record import LogSummary, Recording
from hil.report import Rows, figures, picture
from hil.safety.timing import MISSED_AT
from hil.signals import Mode

RELAXED_WATCHDOG_S = 0.2
"""Watchdog of emulated drives when the loop has no SCHED_FIFO. Real drives keep the configured one."""
FAULT_TICKS_SHOWN = 50
_TAIL_COLUMNS = (
    "tick", "lateness_ns", "skipped", "mode", "faults", "warnings", "age", "drive_state", "q", "dq", "q_d",
    "tau",
)  # fmt: skip


def run_daemon(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    with_plant: bool = False,
    draw: bool = True,
) -> dict[str, Any]:
    """Run until parked, faulted or stopped; return the summary (key `success` tells the outcome).

    Raises ConfigurationError, BusError, PlantError or RunError before anything moves.
    """
    c = configuration
    c.require("run")
    path = log_path(c.recording.folder, c.name, log)
    rate, watchdog_s = _pace(c, with_plant=with_plant)
    budget = bus_budget(c, rate)
    cycle = build_cycle(c, rate, watchdog_s)
    panel = OperatorPanel()
    plant_summary: dict[str, Any] | None = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(panel.attached())
        bus = stack.enter_context(Bus.open(c.bus, role="controller"))
        plant = None
        if with_plant:
            plant = stack.enter_context(SupervisedPlant(c, path.with_name(f"{path.stem}-plant.mcap")))
        recording = stack.enter_context(
            Recording.start(
                path,
                configuration=c.text,
                attachments=attachments(),
                metadata={"kind": "run", "rate_Hz": rate, "watchdog_s": watchdog_s},
                scene=build_scene(c),
                can_channel=c.bus.channel,
                ring_ticks=c.recording.ring_ticks,
                live=True,
                reference_s=cycle.parts.trajectory.duration_s,
            )
        )
        bus.flush_tx()
        with real_time(c.loop.priority, c.loop.cpu) as granted:
            deadlines = Deadlines(rate, c.loop.spin_us if granted.fifo else 0.0)
            window_ns = round(feedback_window_s(c, rate) * 1e9)
            ending = run(cycle, bus, deadlines, recording, panel, window_ns, duration_s)
        trouble = _trouble(ending, c, with_plant=with_plant)
        if trouble:
            recording.event(time.monotonic_ns(), "error", trouble)
        closed = recording.close(
            {"ending": ending.mode.name, "reason": ending.reason, "faults": int(ending.faults)}
        )
        if plant is not None:
            plant_summary = plant.finish()
    result = _summary(c, ending, trouble, granted, rate, budget, closed)
    if plant_summary is not None:
        result["plant"] = plant_summary
    if draw and result.get("tracking", {}).get("ticks"):
        rows = Log.open(closed.path).rows()
        title = f"{c.name}: {result['tracking']['ticks']} ticks at {rate:g} Hz"
        result["picture"] = str(picture(rows, closed.path.with_suffix(".png"), title))
    return result


def _pace(c: Configuration, *, with_plant: bool) -> tuple[float, float]:
    """Return rate (Hz) and drive watchdog (s): the configured ones, or what holds without SCHED_FIFO."""
    rate, watchdog_s = c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3
    if fifo_allowed(c.loop.priority):
        return rate, watchdog_s
    lack = "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"
    if c.loop.without_realtime == "refuse":
        raise RunError(f"{lack}, and loop.without_realtime is `refuse`: nothing was started")
    slow = holdable_rate(rate, MISSED_AT)
    if with_plant:
        watchdog_s = max(watchdog_s, RELAXED_WATCHDOG_S)
    elif 3.0 / slow > watchdog_s:
        raise RunError(
            f"{lack}: this machine holds {slow:g} Hz now, drives.watchdog_ms {watchdog_s * 1e3:g} needs at "
            f"least {3.0 / watchdog_s:.0f} Hz; grant SCHED_FIFO or lengthen the watchdog"
        )
    console.print(
        f"{lack}: the loop runs at {slow:g} Hz instead of {rate:g} Hz"
        + (f", emulated drives' watchdog {watchdog_s * 1e3:g} ms" if with_plant else ""),
        style="bold yellow",
    )
    return slow, watchdog_s


def _trouble(ending: Ending, c: Configuration, *, with_plant: bool) -> str:
    """Say what went wrong and what to do about it; empty for a good ending."""
    if ending.reason == "no drives":
        start = (
            "" if with_plant else f"; for a virtual bench start `hil plant {c.source}` first, or add --plant"
        )
        return (
            f"no drive answered on {c.bus.interface} channel {c.bus.channel} within 2 s: check power, wiring, "
            f"bit rate and drives.node_ids{start}"
        )
    if ending.faults:
        names = ", ".join(str(f.name) for f in ending.faults)
        return f"latched fault {names} at tick {ending.fault_tick}: drives were told to switch off"
    return ending.reason


def _summary(
    c: Configuration,
    ending: Ending,
    trouble: str,
    granted: RealTime,
    rate: float,
    budget: BusBudget | None,
    closed: LogSummary,
) -> dict[str, Any]:
    result: dict[str, Any] = {
        "success": ending.success,
        "kind": "run",
        "configuration": c.source,
        "log": str(closed.path),
        "rate_Hz": rate,
        "trouble": trouble or None,
        "real_time": {"granted": granted.granted, "missing": granted.missing},
        "bus_load_percent": None if budget is None else budget.load_percent,
        "resident_MB": resident_MB(),
    }
    if not closed.complete:
        result["recorder"] = closed.error or f"{closed.dropped} ticks dropped"
    if not closed.ticks:
        return result
    try:
        rows = Log.open(closed.path).rows()
    except LogError as error:
        return result | {"recorder": str(error)}
    result |= figures(rows)
    result["dropped_ticks"] = closed.dropped
    _, result["replay"] = replay_log(closed.path)
    result["success"] = result["success"] and (result["replay"]["exact"] or closed.dropped > 0)
    if ending.mode is Mode.FAULT:
        result["last_ticks"] = _tail(rows, ending.fault_tick)
    return result


def _tail(rows: Rows, fault_tick: int) -> list[dict[str, Any]]:
    """Return the ticks up to the fault, the last FAULT_TICKS_SHOWN of them."""
    until = int(np.searchsorted(rows["tick"], fault_tick, side="right"))
    return [
        {name: row[name].tolist() for name in _TAIL_COLUMNS}
        for row in rows[max(0, until - FAULT_TICKS_SHOWN) : until]
    ]
