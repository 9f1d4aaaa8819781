"""`hil run`: the daemon on the controller PC, in real time, against drives or the plant that it starts."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.can.bus_time import BusBudget
from drivers.errors import LogError, RunError
from hil.app.compose import attachments, build_cycle, build_scene, bus_budget, feedback_window_s
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import law_figures
from hil.app.output import console, log_path, warn
from hil.app.replay import replay_log
from hil.app.run.plant_process import SupervisedPlant
from hil.app.run.rate_selection import pace, stalled
from hil.loop.clock import Deadlines, RealTime, real_time, resident_MB
from hil.loop.daemon import NO_DRIVES_S, Ending, OperatorPanel, run
from hil.loop.setpoints import SetPointSocket
from hil.record import LogSummary, Recording
from hil.record.figures import figures, picture
from hil.record.log import Log
from hil.signals import Mode

FAULT_TICKS_SHOWN = 50
_ENDINGS = {Mode.PARKED: "parked", Mode.FAULT: "fault"}
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
    reset: bool = False,
    slow: str = "",
) -> dict[str, Any]:
    """Run until parked, faulted or stopped; return the summary (key `success` tells the outcome).

    `slow` says why the loop is to run at the rate that this machine holds without real time. The key
    `stalled` says that the machine did not keep the configured rate and that a slower loop outlasts more.
    Raises ConfigurationError, BusError, PlantError or RunError before anything moves.
    """
    c = configuration
    c.require("run")
    panel = OperatorPanel()
    plant_summary: dict[str, Any] | None = None
    plant_trouble = ""
    with contextlib.ExitStack() as stack:
        stack.enter_context(_startable())
        stack.enter_context(panel.attached())
        bus = stack.enter_context(Bus.open(c.bus, role="controller"))
        rate, watchdog_s = pace(c, with_plant=with_plant, lack=slow)
        budget = bus_budget(c, rate)
        cycle = build_cycle(c, rate, watchdog_s)
        path = log_path(c.recording.folder, c.name, log)
        plant = None
        if with_plant:
            plant = stack.enter_context(SupervisedPlant(c, path.with_name(f"{path.stem}-plant.mcap")))
        recording = stack.enter_context(
            Recording.start(
                path,
                configuration=c.text,
                attachments=attachments(c),
                metadata={"kind": "run", "rate_Hz": rate, "watchdog_s": watchdog_s},
                scene=build_scene(c),
                can_channel=c.bus.channel,
                ring_ticks=c.recording.ring_ticks,
                live=console.is_terminal,
                reference_s=cycle.parts.trajectory.duration_s,
            )
        )
        setpoints = None
        if cycle.parts.steering is not None:
            setpoints = stack.enter_context(SetPointSocket(c.bus.interface, c.bus.channel))
        bus.flush_tx()
        bus.drain_now()
        with real_time(c.loop.priority, c.loop.cpu) as granted:
            deadlines = Deadlines(rate, c.loop.spin_us if granted.fifo else 0.0)
            window_ns = round(feedback_window_s(c, rate) * 1e9)
            ending = run(
                cycle,
                bus,
                deadlines,
                recording,
                panel,
                window_ns,
                duration_s,
                reset=reset,
                setpoints=setpoints,
            )
        if plant is not None:
            plant_trouble = plant.trouble()
        trouble = _trouble(ending, c, plant_trouble, with_plant=with_plant)
        if trouble:
            recording.event(time.monotonic_ns(), "error", ending.unexpected or trouble)
        closed = recording.close(
            {"ending": ending.mode.name, "reason": trouble, "faults": int(ending.faults)}
        )
        if plant is not None:
            plant_summary = plant.finish()
    law = law_figures(c.controller, cycle.parts.law)
    result = _summary(c, law, ending, trouble, granted, rate, budget, closed)
    sound = plant_summary is not None and plant_summary["success"] and not panel.interrupts and not slow
    result["stalled"] = sound and stalled(c, cycle.measurement, ending, rate, watchdog_s)
    if "recorder" in result:
        warn(f"hil: {result['recorder']}")
    if plant_summary is not None:
        result["plant"] = plant_summary
        result["success"] = result["success"] and plant_summary["success"]
    if draw and result.get("tracking", {}).get("ticks"):
        rows = Log.open(closed.path).rows()
        title = f"{c.name}: {result['tracking']['ticks']} ticks at {rate:g} Hz"
        result["picture"] = str(picture(rows, closed.path.with_suffix(".png"), title))
    return result


@contextlib.contextmanager
def _startable() -> Iterator[None]:
    """Turn a signal that comes before the loop into one message."""
    try:
        yield
    except KeyboardInterrupt:
        raise RunError("stopped on request before the loop began: nothing has moved") from None


def _trouble(ending: Ending, c: Configuration, plant: str, *, with_plant: bool) -> str:
    """Say what went wrong and what to do about it; empty for a good ending."""
    text = ending.reason
    if text == "no drives":
        start = (
            "" if with_plant else f"; for a virtual bench start `hil plant {c.source}` first, or add --plant"
        )
        text = (
            f"no drive answered on {c.bus.interface} channel {c.bus.channel} within {NO_DRIVES_S:g} s: check "
            f"power, wiring, bit rate and drives.node_ids{start}"
        )
    elif ending.mode is Mode.FAULT:
        text = f"{text} at tick {ending.fault_tick}: drives were told to switch off"
    return "; ".join(filter(None, (text, plant)))


def _summary(
    c: Configuration,
    law: dict[str, Any],
    ending: Ending,
    trouble: str,
    granted: RealTime,
    rate: float,
    budget: BusBudget | None,
    closed: LogSummary,
) -> dict[str, Any]:
    result: dict[str, Any] = {
        "success": ending.success and not trouble,
        "kind": "run",
        "ending": _ENDINGS.get(ending.mode, "not begun") + (" on request" if ending.requested else ""),
        "configuration": c.source,
        "log": str(closed.path),
        "rate_Hz": rate,
        **law,
        "trouble": trouble or None,
        "real_time": {"granted": granted.granted, "missing": granted.missing},
        "bus_load_percent": None if budget is None else budget.load_percent,
        "resident_MB": resident_MB(),
    }
    dropped = closed.dropped + closed.lost
    if not closed.complete:
        result["recorder"] = f"{closed.error or 'too slow'}: {dropped} ticks are not in the log"
    if not closed.ticks:
        return result | {"dropped_ticks": dropped}
    try:
        rows = Log.open(closed.path).rows()
    except LogError as error:
        return result | {"recorder": f"{result['recorder']}; {error}", "dropped_ticks": dropped}
    result |= figures(rows)
    result["dropped_ticks"] = dropped
    _, result["replay"] = replay_log(closed.path)
    lossy = closed.dropped > 0 and not result["replay"]["different_ticks"]
    result["success"] = result["success"] and (result["replay"]["agrees"] or lossy)
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
