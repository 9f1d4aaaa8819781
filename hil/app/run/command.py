"""`hil run`: the real-time controller, for real drives or for a plant that the command itself starts."""

import contextlib
import os
import select
import signal
import sys
from collections.abc import Callable, Sequence
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
from hil.app.run.processes import SupervisedPlant, WatchProcess
from hil.app.run.stretching import STRANGER, begin, bench_clock, stretches
from hil.loop.clock import (
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
from hil.loop.cycle import Cycle
from hil.loop.daemon import Shell, run
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import NO_DRIVES, NO_DRIVES_S, Course, Ending
from hil.operate.channel import OperatorChannel
from hil.operate.client import OperatorClient
from hil.record import LogSummary, scheduling
from hil.record.figures import picture
from hil.record.log import plant_log_beside

RELAXED_WATCHDOG_S = 0.2
"""Watchdog of emulated drives in a loop without real time. Real drives keep the configured one."""


def select_rate(c: Configuration, *, with_plant: bool, stretching: bool = False) -> tuple[float, float]:
    """(rate Hz, drive watchdog s): as configured, or as this machine can hold.

    with_plant: the drives are emulated on this machine. stretching: the bench's time pauses while this
    machine is late, so the configured values stay. Raises RunError: the loop may not be slowed down.
    """
    rate, watchdog_s = c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3
    if stretching and c.loop.without_realtime == "slow":
        return rate, watchdog_s
    lack = _lack(c, with_plant=with_plant)
    if not lack:
        return rate, watchdog_s
    if c.loop.without_realtime == "refuse":
        raise RunError(f"{lack}, and loop.without_realtime is `refuse`: nothing was started")
    slow, worst_s = holdable_rate(rate, patience(c))
    if with_plant:
        watchdog_s = max(watchdog_s, RELAXED_WATCHDOG_S)
    elif 3.0 / slow > watchdog_s:
        raise RunError(
            f"{lack}: this machine holds {slow:g} Hz now, drives.watchdog_ms {watchdog_s * 1e3:g} needs at "
            f"least {3.0 / watchdog_s:.0f} Hz; grant SCHED_FIFO or lengthen the watchdog"
        )
    text = f"{lack}: the loop runs at {slow:g} Hz instead of {rate:g} Hz" if slow < rate else lack
    if with_plant:
        text += f", emulated drives' watchdog {watchdog_s * 1e3:g} ms"
    if worst_s * slow > patience(c):
        text += f"; stalls of {1e3 * worst_s:.0f} ms now: expect a controlled stop, or free this machine"
    warn(text)
    return slow, watchdog_s


def _lack(c: Configuration, *, with_plant: bool) -> str:
    """Reason why this machine cannot run the loop in real time; empty if it can, or if limits allow stalls.

    With the plant on the same machine SCHED_FIFO must be granted and kept: late feedback makes a leg stale.
    """
    if not fifo_allowed(c.loop.priority):
        return "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"
    stall_s = min(patience(c) / c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)  # longest stall that ends no run
    if not with_plant or stall_s >= STALL_S:
        return ""
    late = late_share(c.loop.rate_Hz, c.loop.priority)
    if late <= LATE_SHARE:
        return ""
    late_us = 1e6 * LATE_PERIODS / c.loop.rate_Hz
    return (
        f"this machine does not keep SCHED_FIFO, {100 * late:.1f} % of its wake-ups are {late_us:.0f} us late"
    )


def patience(c: Configuration) -> int:
    """Longest stall of the loop, in periods, that does not end a run."""
    return min(c.limits.missed_stop_ticks, c.limits.stale_fault_ticks)


_LONGEST = 1024


class EnterKey:
    """Enter key of the terminal, which counts while this process runs in its foreground.

    Mutable state: whether the first call has discarded earlier input; whether the terminal has closed.
    """

    def __init__(self, hung_up: Callable[[], None], fd: int = 0) -> None:
        """fd: the terminal. hung_up: called once when the terminal has closed.

        Raises RunError: fd is not a terminal, or this process is not in its foreground.
        """
        try:
            ours = os.isatty(fd) and os.tcgetpgrp(fd) == os.getpgrp()
        except OSError:
            ours = False
        if not ours:
            raise RunError(
                "the platform moves only with the operator's consent, and there is no terminal to press "
                "Enter in: add --arm, or --wait-for-arm and run `hil ctl CONFIG arm`"
            )
        self._fd = fd
        self._hung_up = hung_up
        self._poll = select.poll()
        self._poll.register(fd, select.POLLIN)
        self._asked = self._gone = False

    def pressed(self) -> bool:
        """True if Enter was pressed since the last call. The first call discards earlier input."""
        if self._gone:
            return False
        import termios  # noqa: PLC0415 - not on Windows

        try:
            if not self._asked:
                self._asked = True
                termios.tcflush(self._fd, termios.TCIFLUSH)
                return False
            if not self._poll.poll(0):
                return False
            typed = os.read(self._fd, _LONGEST)
        except (OSError, termios.error):
            typed = b""
        self._gone = not typed
        if self._gone:
            self._hung_up()
        return b"\n" in typed


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
