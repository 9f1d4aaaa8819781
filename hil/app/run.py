"""`hil run`: the daemon on the controller PC, in real time, against drives or the plant that it starts."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from drivers.bus import Bus
from drivers.bustime import BusBudget
from drivers.errors import LogError, RunError
from hil.app.compose import attachments, build_cycle, build_scene, bus_budget, feedback_window_s
from hil.app.configuration import Configuration
from hil.app.controller_file import law_figures
from hil.app.output import console, log_path
from hil.app.replay import replay_log
from hil.app.supervise import SupervisedPlant
from hil.clock import (
    LATE_PERIODS,
    LATE_SHARE,
    STALL_S,
    Deadlines,
    RealTime,
    fifo_allowed,
    holdable_rate,
    late_share,
    real_time,
    resident_MB,
)
from hil.daemon import NO_DRIVES_S, Ending, OperatorPanel, run
from hil.log import Log
from hil.record import LogSummary, Recording
from hil.report import Rows, figures, picture
from hil.setpoints import SetPointSocket
from hil.signals import Mode

RELAXED_WATCHDOG_S = 0.2
"""Watchdog of emulated drives when the loop has no SCHED_FIFO. Real drives keep the configured one."""
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
) -> dict[str, Any]:
    """Run until parked, faulted or stopped; return the summary (key `success` tells the outcome).

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
        rate, watchdog_s = _pace(c, with_plant=with_plant)
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
    if "recorder" in result:
        console.print(f"hil: {result['recorder']}", style="bold yellow", soft_wrap=True)
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


def _pace(c: Configuration, *, with_plant: bool) -> tuple[float, float]:
    """Return rate (Hz) and drive watchdog (s): the configured ones, or what holds without real time."""
    rate, watchdog_s = c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3
    lack = _lack(c, with_plant=with_plant)
    if not lack:
        return rate, watchdog_s
    if c.loop.without_realtime == "refuse":
        raise RunError(f"{lack}, and loop.without_realtime is `refuse`: nothing was started")
    slow, worst_s = holdable_rate(rate, c.limits.missed_stop_ticks)
    if with_plant:
        watchdog_s = max(watchdog_s, RELAXED_WATCHDOG_S)
    elif 3.0 / slow > watchdog_s:
        raise RunError(
            f"{lack}: this machine holds {slow:g} Hz now, drives.watchdog_ms {watchdog_s * 1e3:g} needs at "
            f"least {3.0 / watchdog_s:.0f} Hz; grant SCHED_FIFO or lengthen the watchdog"
        )
    consequences = []
    if slow < rate:
        consequences.append(f"the loop runs at {slow:g} Hz instead of {rate:g} Hz")
    if with_plant:
        consequences.append(f"emulated drives' watchdog {watchdog_s * 1e3:g} ms")
    said = lack + (f": {', '.join(consequences)}" if consequences else "")
    if worst_s * slow > c.limits.missed_stop_ticks:
        stall_ms = worst_s * 1e3
        said += f"; stalls of {stall_ms:.0f} ms now: expect a controlled stop, or take load off this machine"
    console.print(said, style="bold yellow")
    return slow, watchdog_s


def _lack(c: Configuration, *, with_plant: bool) -> str:
    """Say why the loop has no real time; empty if it has, or if the limits outlast what may come.

    With the plant on this machine, too, SCHED_FIFO has to be kept and not only granted: an answer that comes
    later than the feedback window is a stale leg.
    """
    if not fifo_allowed(c.loop.priority):
        return "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"
    limit_s = min(c.limits.missed_stop_ticks, c.limits.stale_fault_ticks) / c.loop.rate_Hz
    if not with_plant or limit_s >= STALL_S:
        return ""
    late = late_share(c.loop.rate_Hz, c.loop.priority)
    if late <= LATE_SHARE:
        return ""
    late_us = 1e6 * LATE_PERIODS / c.loop.rate_Hz
    return (
        f"this machine does not keep SCHED_FIFO, {100 * late:.1f} % of its wake-ups are {late_us:.0f} us late"
    )


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
