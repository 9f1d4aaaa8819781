"""`hil plant`: the other end of the bus in real time, six emulated drives in front of a plant.

It depends on frames and time only, so that it can test other controllers as well.
"""

import contextlib
import os
import select
import signal
import subprocess
import time
import traceback as tracebacks
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.clock import Clock
from drivers.errors import HilError, PlantError, RunError
from drivers.family import Family
from drivers.frame_array import NO_FRAMES, joined, sent_frames
from drivers.signals import DriveState
from hil.app.compose import attachments, build_nodes, build_protocol, build_scene
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_words import show_fault
from hil.app.output import log_path
from hil.app.plant_rows import PLANT, PlantRows, at_rest, plant_warnings
from hil.loop.clock import real_time
from hil.loop.panel import signals_to
from hil.record import Recording, scheduling
from plant_fmu.drives.drive import Snapshot
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import PROCESS, ProcessKill, ProcessSlow, ProcessStop
from plant_fmu.plant import Plant

IDLE_NS = 2_000_000
"""Largest lag of the plant behind real time. During a run the frames wake it more often; needless
wake-ups at real-time priority would starve the recorders.
"""
LOOK_NS = 20_000_000
"""Period of the checks for an end."""
ORPHAN_S = 3.0
"""Longest life of a supervised plant after its supervisor: time for the drives to stop the platform."""
REST_NS = 200_000_000
"""Time at rest after which an orphaned plant ends."""
CLOSING_S = 5.0
"""Longest time to close the log of an orphaned plant."""


class ProcessFaults:
    """Kills, stops and slows this process at the configured times, to test the controller.

    Mutable state: the faults still to come.
    """

    def __init__(self, faults: Iterable[Fault], t0_ns: int) -> None:
        self._left = [
            (t0_ns + round(fault.at_s * 1e9), fault) for fault in faults if isinstance(fault, PROCESS)
        ]

    def strike(self, now_ns: int) -> None:
        """Apply the faults that are due at now_ns."""
        for entry in list(self._left):
            at_ns, fault = entry
            if now_ns < at_ns:
                continue
            match fault:
                case ProcessKill():
                    os.kill(os.getpid(), signal.SIGKILL)
                case ProcessStop(for_s=for_s):
                    self._left.remove(entry)
                    script = f"kill -STOP {os.getpid()}; sleep {for_s:.6f}; kill -CONT {os.getpid()}"
                    subprocess.Popen(["/bin/sh", "-c", script], start_new_session=True)
                case ProcessSlow(by_ms=by_ms) if now_ns < at_ns + fault.lasts_ns:
                    time.sleep(1e-3 * by_ms)
                case _:
                    self._left.remove(entry)


class Bench(NamedTuple):
    """Emulated drives with a plant other than the configured one, and a callback for manual work on it."""

    nodes: Nodes
    plant: Plant
    hands: Callable[[], None]
    """Called in each pass of the loop: carries out requested manual work."""


def run_plant(
    configuration: Configuration,
    *,
    log: Path | None = None,
    duration_s: float | None = None,
    supervisor: int | None = None,
    ready: Callable[[], None] = lambda: None,
    bench: Bench | None = None,
) -> dict[str, Any]:
    """Serve the drives until SIGINT, SIGTERM, SIGHUP, `duration_s`, or the supervisor's pipe closes.

    supervisor: read end of a pipe that the supervising process holds open. An orphaned plant continues until
    its drives have stopped the platform, for at most ORPHAN_S. `bench` takes the place of the configured
    plant. Raises ConfigurationError, BusError, PlantError; RunError when another plant serves the bus.
    """
    c = configuration
    c.require("plant")
    assert c.plant is not None
    with contextlib.ExitStack() as stack:
        bus = stack.enter_context(_open_bus(c, 0.0 if supervisor is None else ORPHAN_S + CLOSING_S))
        ours = supervisor is not None or bench is not None  # another controller does not hold time
        if ours and c.loop.on_stall == "stretch" and isinstance(bus.clock, BenchClock):
            bus.clock.holds = True
        served = bench or Bench(*build_nodes(c), lambda: None)
        stack.callback(served.plant.close)
        recording = None
        if c.plant.log:
            recording = stack.enter_context(
                Recording.start(
                    log_path(c.recording.folder, c.name, log, "-plant"),
                    configuration=c.text,
                    table=PLANT,
                    attachments=attachments(c),
                    metadata={"kind": "plant"},
                    scene=build_scene(c),
                    can_channel=[each.channel for each in c.bus.buses],
                    ring_ticks=c.recording.ring_ticks,
                    clock=bus.clock,
                )
            )
        if recording is not None:
            for fault in c.plant.faults:
                recording.event(bus.clock.now(), "info", f"to be injected: {show_fault(fault)}")
        stop = _Stop()
        stack.enter_context(signals_to(stop.signalled))
        with real_time(max(1, c.loop.priority - 10), None) as granted:
            scheduled = scheduling()
            ready()
            try:
                with _failures_logged(recording, bus.clock):
                    faults = ProcessFaults(c.plant.faults, bus.clock.now())
                    protocol = build_protocol(c)
                    last = _serve(served, bus, recording, stop, duration_s, supervisor, faults, protocol)
                    trouble = ""
            except PlantError as error:
                last, trouble = served.nodes.snapshot(), str(error)
            finally:
                bus.clock.leave()
        summary: dict[str, Any] = {
            "success": not trouble,
            "trouble": trouble or None,
            "kind": "plant",
            "ending": stop.reason,
            "real_time": {"granted": granted.granted, "missing": granted.missing},
            "syncs": last.syncs,
            "commands": last.commands,
            "rejected_frames": last.rejected,
            "final_states": [DriveState(int(s)).name for s in last.state],
            "peak_final_rate_m_s": float(np.abs(last.rate).max()),
            **plant_warnings(served.plant, recording, bus.clock.now()),
        }
        if recording is not None:
            closed = recording.close({k: v for k, v in summary.items() if k != "success"} | scheduled)
            summary |= {"log": str(closed.path), "dropped_ticks": closed.dropped + closed.lost}
            if not closed.complete:
                summary["recorder"] = closed.error or "too slow"
            if closed.gave_up:
                summary |= {"success": False, "trouble": trouble or closed.error}
    return summary


def _open_bus(c: Configuration, patience_s: float) -> Bus:
    """Open the bus in the role `plant`; wait up to `patience_s` for an earlier plant that still ends."""
    end = time.monotonic() + patience_s
    while True:
        try:
            return Bus.open(c.bus, role="plant")
        except RunError:
            if time.monotonic() >= end:
                raise
            time.sleep(0.05)


class _Stop:
    """Reason to end, set by signals, which otherwise would truncate the log. Mutable state: the reason."""

    def __init__(self) -> None:
        self.reason = ""

    def signalled(self, signum: int, frame: FrameType | None) -> None:
        del frame
        self.reason = signal.Signals(signum).name


@contextlib.contextmanager
def _failures_logged(recording: Recording | None, clock: Clock) -> Iterator[None]:
    """Record an error in the log, then raise it again.

    A defect of this program becomes a PlantError as well: the plant falls silent, which stops the controller.
    """
    try:
        yield
    except HilError as error:
        if recording is not None:
            recording.event(clock.now(), "error", str(error))
        raise
    except Exception as error:
        if recording is not None:
            recording.event(clock.now(), "error", tracebacks.format_exc())
        raise PlantError(
            f"the plant failed, {type(error).__name__}: {error}; its log has the details"
        ) from error


def _serve(
    bench: Bench,
    bus: Bus,
    recording: Recording | None,
    stop: _Stop,
    duration_s: float | None,
    supervisor: int | None,
    faults: ProcessFaults,
    protocol: Family,
) -> Snapshot:
    nodes = bench.nodes
    now = bus.clock.now()
    bus.drain_now()
    nodes.start(now)
    end = None if duration_s is None else now + round(duration_s * 1e9)
    next_look = now
    later = NO_FRAMES
    rows = PlantRows(None if recording is None else recording.tick, nodes)
    moved_ns = 0
    try:
        while not stop.reason:
            received = bus.drain_now()
            rows.write(now, answered=not len(received))
            if not len(received):
                due = (nodes.next_reading_ns, *later["t_ns"].tolist())
                received = bus.wait(min((now + IDLE_NS, *(t_ns for t_ns in due if t_ns > now))))
            now = bus.clock.now()
            faults.strike(now)
            bench.hands()
            queued = nodes.advance(now, received)
            outgoing = latest(queued, now, protocol)
            if len(later) or len(outgoing) < len(queued):
                outgoing = joined([later[later["t_ns"] <= now], outgoing])
                later = joined([each[each["t_ns"] > now] for each in (later, queued)])
            bus.send(outgoing)
            rows.take(received, outgoing, now)
            if now >= next_look:
                next_look = now + LOOK_NS
                if end is not None and now >= end:
                    stop.reason = stop.reason or ("orphaned" if moved_ns else "duration")
                if supervisor is not None and select.select([supervisor], [], [], 0)[0]:
                    supervisor, end, moved_ns = None, now + round(ORPHAN_S * 1e9), now
                if moved_ns:
                    if not at_rest(nodes.snapshot()):
                        moved_ns = now
                    elif now - moved_ns >= REST_NS:
                        stop.reason = stop.reason or "orphaned"
    finally:
        rows.write(now)
    return nodes.snapshot()


def latest(queued: Rows, now_ns: int, protocol: Family) -> Rows:
    """Queued frames that are due by `now_ns`, without outdated feedback.

    After a stall of this process several SYNCs are answered at once. Outdated feedback would load the bus and
    delay current feedback: a stall of 2.6 ms caused 5 stale ticks at 1 kHz. As in a drive's mailbox, newer
    feedback of the same drive and bus takes the place of older feedback. Two frames of one instant come from
    two nodes, or from a fault: both are sent, and so is every frame that is not feedback.
    """
    times = queued["t_ns"].tolist()
    due = [k for k, t_ns in enumerate(times) if t_ns <= now_ns]
    if not due or times[due[0]] == times[due[-1]]:
        return queued if len(due) == len(queued) else queued[due]
    newest: dict[tuple[int, int, int], tuple[int, list[int]]] = {}
    sent: list[list[int]] = []
    for k, frame in zip(due, sent_frames(queued[due]), strict=True):
        t_ns, which = times[k], protocol.awaited(frame)
        if which not in protocol.traits.feedback_ids:
            sent.append([k])
            continue
        key = frame.id, frame.bus, which
        before_ns, together = newest.get(key, (t_ns, []))
        if not together:
            sent.append(together)
        if before_ns < t_ns:
            together.clear()
        together.append(k)
        newest[key] = t_ns, together
    return queued[[k for together in sent for k in together]]
