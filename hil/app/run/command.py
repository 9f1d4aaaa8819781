"""`hil run`: the real-time controller, for real drives or for a plant that the command itself starts."""

import contextlib
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.errors import RunError
from drivers.signals import Fault, Mode
from hil.app.adapter.qualification import differences
from hil.app.compose import build_cycle, record
from hil.app.configuration.bus_budget import bus_names, loads, shortest_answer_ns
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import law_figures
from hil.app.homing.keeper import Keeper
from hil.app.log_budget import make_room, needed_bytes
from hil.app.output import (
    after_run,
    end_record,
    fail,
    fault_story,
    further,
    leaving,
    log_path,
    picture_beside,
    warn,
)
from hil.app.replay import measured
from hil.app.run.consent import EnterKey
from hil.app.run.processes import SupervisedPlant, WatchProcess
from hil.app.run.rate_selection import select_rate
from hil.app.run.stretching import STRANGER, begin, bench_clock, stretches
from hil.loop.clock import Deadlines, RealTime, real_time, resident_MB
from hil.loop.cycle import Cycle
from hil.loop.daemon import Shell, run
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import NO_DRIVES, NO_DRIVES_S, Course, Ending
from hil.operate.channel import OperatorChannel
from hil.operate.client import OperatorClient
from hil.record import LogSummary, scheduling
from hil.record.figures import picture
from hil.record.log import plant_log_beside

_ENDINGS = {Mode.PARKED: "parked", Mode.FAULT: "fault", Mode.HELD: "held"}


def run_daemon(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    with_plant: bool = False,
    draw: bool = True,
    reset: bool = False,
    arm: bool = False,
    wait_for_arm: bool = False,
    faults: Sequence[str] = (),
    with_watch: bool = False,
    on_bench: bool = False,
) -> dict[str, Any]:
    """Run the controller until parked, faulted or stopped; return the summary (key `success`).

    arm: the platform may move as soon as the drives are ready; by default after Enter. wait_for_arm: only
    command `arm` on the operator channel lets it move. faults: faults of the started plant, in the words of
    `--fault`. with_watch: also serve the page of `hil watch`. on_bench: another process serves an emulated
    bench on the bus. Raises ConfigurationError, BusError, PlantError, LogError or RunError before anything
    moves.
    """
    c = configuration
    c.require("run")
    unlike = differences(c)
    for text in unlike:
        warn(f"hil: {text}")
    panel = OperatorPanel()
    consent = None if arm or wait_for_arm else EnterKey(lambda: _hung_up(panel)).pressed
    plant_summary: dict[str, Any] | None = None
    with contextlib.ExitStack() as stack:
        stack.enter_context(leaving(lambda: "before the loop began: nothing has moved"))
        stack.enter_context(panel.attached())
        bus = stack.enter_context(Bus.open(c.bus, role="controller"))
        clock = bench_clock(c, bus) if with_plant or on_bench else None
        rate, watchdog_s = select_rate(c, with_plant=with_plant, stretching=clock is not None)
        keeper = Keeper(c, emulated=with_plant, on_bench=on_bench)
        cycle = build_cycle(c, rate, watchdog_s, last_pose=keeper.last_pose)
        path = log_path(c.recording.folder, c.name, log)
        drawn = picture_beside(path, "--log") if draw and find_spec("matplotlib") else None
        removed = make_room(c, needed_bytes(c, cycle.parts.trajectory.duration_s, duration_s), log)
        plant = None
        if with_watch:
            stack.enter_context(WatchProcess(c))  # first: its link is printed before the question to move
        if with_plant:
            plant_log = plant_log_beside(path)
            plant = stack.enter_context(SupervisedPlant(c, plant_log, faults, watchdog_s))
        recording = stack.enter_context(
            record(c, cycle, path, "run", live=sys.stderr.isatty(), clock=bus.clock)
        )
        channel = stack.enter_context(OperatorChannel(c.bus.interface, c.bus.channel))
        if removed:
            recording.event(bus.clock.now(), "info", f"removed for recording.budget_GB: {', '.join(removed)}")
        stack.callback(keeper.close)
        keeper.begin(cycle)
        bus.flush_tx()
        bus.drain_now()
        for text in unlike:
            recording.event(bus.clock.now(), "warning", text)
        if bus.facts:
            recording.event(bus.clock.now(), "info", bus.facts)
        with real_time(c.loop.priority, c.loop.cpu) as granted:
            scheduled = scheduling() | {"granted": granted.granted, "missing": granted.missing}
            window_ns = round(c.loop.window_s(rate) * 1e9)
            if clock is not None:
                begin(clock, c, cycle.parts.protocol, cycle.begin(0), window_ns)
            deadlines = Deadlines(rate, c.loop.spin_us if granted.fifo else 0.0, clock=bus.clock)
            shortest_ns = 0 if bus.virtual else shortest_answer_ns(c.bus, cycle.parts.protocol)
            answer_ns = None if bus.knows_ends else shortest_ns
            shell = Shell(bus, deadlines, recording, panel, window_ns, channel, consent, _say, answer_ns)
            try:
                course = Course(
                    cycle, duration_s, armed=arm, reset=reset, stays=True, goes_on=c.operator.stays,
                    event=recording.event,
                )  # fmt: skip
                ending = run(course, shell)
                interrupted = clock is not None and clock.interrupted
            finally:
                bus.clock.leave()
        explained = _explained(ending, c, with_plant=with_plant)
        if plant is not None and (plant.trouble() or explained is not ending or Fault.STALE in ending.faults):
            plant_summary = plant.finish()  # its failure is the cause of what the controller saw
            explained = explained.blamed(plant_summary.get("trouble") or "")
        ending, trouble = explained, explained.trouble
        if trouble:
            recording.event(bus.clock.now(), "error", ending.unexpected or trouble)
        closed = recording.close(end_record(ending, trouble) | scheduled)
        if plant is not None:
            plant_summary = plant_summary or plant.finish()
    with leaving(lambda: f"{after_run(ending)}; its log, not replayed: {closed.path}"):
        result, rows = _summary(c, cycle, ending, granted, closed)
        if clock is not None and rows is not None:
            result["bench_time"] = stretches(rows["stretched_ns"])
        result |= keeper.summary(cycle)
        fail(result, keeper.trouble)
        if drawn is not None and rows is not None and result.get("tracking", {}).get("ticks"):
            title = f"{c.name}: {result['tracking']['ticks']} ticks at {result['rate_Hz']:g} Hz"
            with further(result):
                result["picture"] = str(picture(rows, drawn, title))
    if interrupted:
        warn(f"hil: {STRANGER}")
    if removed:
        result["removed_logs"] = removed
    if "recorder" in result and not closed.gave_up:
        warn(f"hil: {result['recorder']}")
    if plant_summary is not None:
        result["plant"] = plant_summary
        result["success"] = result["success"] and plant_summary["success"]
    return result


def release_held(configuration: Configuration) -> dict[str, Any]:
    """Make the running controller of a configuration release the platform that it holds with force.

    Returns the summary. Raises RunError: no controller runs, or it holds no platform.
    """
    bus = configuration.bus
    with OperatorClient(bus.interface, bus.channel) as client:
        answer = client.release()
    if not answer:
        where = f"bus {bus.interface}:{bus.channel}"
        raise RunError(f"the controller on {where} released nothing: {answer.why}")
    return {"success": True, "kind": "release", "configuration": configuration.source}


def _hung_up(panel: OperatorPanel) -> None:
    """Request a controlled stop when the terminal has closed, as SIGHUP does.

    SIGHUP itself is ignored from then on: it must not count as a second signal.
    """
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    if not panel.interrupts:
        panel.interrupt(signal.SIGHUP, None)


def _say(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, f"\nhil: {text}\n".encode(errors="replace"))


def _explained(ending: Ending, c: Configuration, *, with_plant: bool) -> Ending:
    """Ending with advice in its reason if no drive answered."""
    if ending.reason != NO_DRIVES:
        return ending
    start = "" if with_plant else f"; for a virtual plant start `hil plant {c.source}` first, or add --plant"
    buses = zip(c.bus.buses, bus_names(c.bus), strict=True)
    where = " and ".join(f"{each.interface} channel {name}" for each, name in buses)
    text = f"no drive answered on {where} within {NO_DRIVES_S:g} s: check power, wiring, bit rate and "
    return replace(ending, reason=f"{text}drives.node_ids{start}")


def _summary(
    c: Configuration, cycle: Cycle, ending: Ending, granted: RealTime, closed: LogSummary
) -> tuple[dict[str, Any], Rows | None]:
    """Summary of a run, and the rows of its log; None if the log cannot be read."""
    rate, dropped = cycle.parts.rate_Hz, closed.dropped + closed.lost
    result: dict[str, Any] = {
        "success": ending.success and not ending.trouble,
        "kind": "run",
        "ending": _ENDINGS.get(ending.mode, "not begun") + (" on request" if ending.requested else ""),
        "configuration": c.source,
        "log": str(closed.path),
        "rate_Hz": rate,
        **law_figures(c.controller, cycle.parts.law),
        "trouble": ending.trouble or None,
        "story": fault_story(ending),
        "real_time": {"granted": granted.granted, "missing": granted.missing},
        **loads(c.bus, c.drives, c.sensors, rate, c.folder),
        "resident_MB": resident_MB(),
        "dropped_ticks": dropped,
    }
    if not closed.complete:
        result["recorder"] = f"{closed.error or 'too slow'}: {dropped} ticks are not in the log"
    if closed.gave_up:
        fail(result, result["recorder"])
    rows = measured(result, closed.path, closed.error) if closed.ticks else None
    result["dropped_ticks"] = dropped  # of the whole run, not only those before the end of the log
    if rows is not None and "replay" in result:
        steps = np.diff(rows["tick"], prepend=-1) - 1 - rows["skipped"]  # ticks missing in the log
        lossy = int(steps.sum()) == closed.dropped > 0 and not result["replay"]["different_ticks"]
        result["success"] &= result["replay"]["agrees"] or lossy
    return result, rows
