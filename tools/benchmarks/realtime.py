"""The loop in real time against `hil plant`: wake-ups, latency, stale and skipped ticks, compute, recorder.

It runs `hil.loop.daemon.run`; only its bus looks at a clock as well.
"""

import contextlib
import time
from array import array
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from contextlib import ExitStack
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.can.link import Link
from drivers.can.runtime_folder import RoleLock
from drivers.errors import RunError
from drivers.signals import Mode
from hil.app.compose import build_cycle, record
from hil.app.configuration.configuration import Configuration, load
from hil.app.run.plant_process import SupervisedPlant
from hil.app.run.rate_selection import RELAXED_WATCHDOG_S, patience
from hil.loop.clock import Deadlines, RealTime, fifo_allowed, holdable_rate, real_time
from hil.loop.daemon import Shell, run
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course, Ending
from hil.record import LogSummary
from hil.record.figures import figures as run_figures
from hil.record.log import Log
from tools.benchmarks.benchmark import TWO_BUSES, Benchmark
from tools.benchmarks.cyclictest import cyclictest
from tools.benchmarks.figures import EARLY, Figure, Mark, spread
from tools.benchmarks.patience import patience_figures
from tools.benchmarks.process import cpu_s
from tools.benchmarks.timed_cycle import compute_figure

CYCLICTEST_S = 10.0
TWO_BUSES_S = 20.0
_now = time.monotonic_ns


class StampedBus(Bus):
    """Bus that notes when SYNC goes in, when the drain ends, and when the command is out.

    Mutable state beside the bus': `stamps`, three numbers (ns) a tick.
    """

    def __init__(self, links: Sequence[Link], role: RoleLock | ExitStack | None = None) -> None:
        super().__init__(links, role)
        self.stamps = array("q")

    def send(self, frames: Rows) -> int:
        """As Bus.send."""
        opening = len(self.stamps) % 3 == 0
        if opening:
            self.stamps.append(_now())
        refused = super().send(frames)
        if not opening:
            self.stamps.append(_now())
        return refused

    def drain(self, deadline_ns: int, wanted: AbstractSet[int]) -> Rows:
        """As Bus.drain; of two in a tick the last one counts."""
        received = super().drain(deadline_ns, wanted)
        if len(self.stamps) % 3 == 1:
            self.stamps.append(_now())
        else:
            self.stamps[-1] = _now()
        return received

    def latencies(self) -> tuple[Any, Any]:
        """Return the times (ns) from SYNC to the end of the drain and to the command's sending, by tick."""
        table = np.array(self.stamps, np.int64)
        table = table[: table.size // 3 * 3].reshape(-1, 3)
        return table[:, 1] - table[:, 0], table[:, 2] - table[:, 0]


class Measured(NamedTuple):
    """What a run leaves."""

    bus: StampedBus
    ending: Ending
    granted: RealTime
    rate_Hz: float
    closed: LogSummary
    recorder_share: float
    """Processor time of the recorder over the run's, %."""


def measure(c: Configuration, benchmark: Benchmark, seconds: float) -> Measured:
    """Run the daemon's loop for so long with its plant.

    Raises HilError as `hil run` does, KeyboardInterrupt once it has parked after one.
    """
    rate, watchdog_s = c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3
    if not fifo_allowed(c.loop.priority):  # as `hil run` slows down without the right
        rate = holdable_rate(rate, patience(c))[0]
        watchdog_s = max(watchdog_s, RELAXED_WATCHDOG_S)
    cycle = build_cycle(c, rate, watchdog_s)
    panel = OperatorPanel()
    with contextlib.ExitStack() as stack:
        bus = stack.enter_context(StampedBus.open(c.bus, role="controller"))
        assert isinstance(bus, StampedBus)
        stack.enter_context(panel.attached())
        plant = stack.enter_context(SupervisedPlant(c, benchmark.folder / f"{c.name}-plant.mcap"))
        recording = stack.enter_context(record(c, cycle, benchmark.folder / f"{c.name}-run.mcap", "run"))
        recorder = recording._process.pid  # noqa: SLF001 - its start is not part of the figure
        bus.flush_tx()
        bus.drain_now()
        with real_time(c.loop.priority, c.loop.cpu) as granted:
            used, begun = cpu_s(recorder), time.monotonic()
            deadlines = Deadlines(rate, c.loop.spin_us if granted.fifo else 0.0)
            window_ns = round(c.loop.window_s(rate) * 1e9)
            shell = Shell(bus, deadlines, recording, panel, window_ns)
            ending = run(Course(cycle, seconds), shell)
            wall = time.monotonic() - begun
        closed = recording.close({"ending": ending.mode.name, "reason": ending.reason})
        plant.finish()
    if panel.interrupts:
        raise KeyboardInterrupt  # nothing else is to run, either
    return Measured(bus, ending, granted, rate, closed, 100.0 * (closed.recorder_cpu_s - used) / wall)


def realtime(benchmark: Benchmark) -> list[Figure]:
    """Run the loop in real time, the plant in a second process, the recorder in a third.

    Raises HilError as `hil run` does, RunError also for a run that never powered the drives.
    """
    return _figures(benchmark.endless, benchmark.configuration, benchmark, benchmark.seconds)


def two_buses(benchmark: Benchmark) -> list[Figure]:
    """Run the loop at 2 kHz on two buses, as far as this machine allows: figures without marks.

    Raises HilError as `realtime` does.
    """
    seconds = min(TWO_BUSES_S, benchmark.seconds)
    found = _figures(benchmark.two_buses, load(TWO_BUSES), benchmark, seconds)
    return [replace(each, mark=None) for each in found]


def of_their_tick(feedback: Any, command: Any, age: Any) -> tuple[Any, Any]:
    """Return the times of the ticks without an answer of an earlier one, which would end the wait too soon.

    feedback, command (n,): ns. age (n, 6): ticks. Where no tick is so, all.
    """
    n = min(len(feedback), len(age))
    whole = (age[:n] == 0).all(axis=1)
    return (feedback[:n][whole], command[:n][whole]) if whole.any() else (feedback, command)


def _figures(c: Configuration, shipped: Configuration, benchmark: Benchmark, seconds: float) -> list[Figure]:
    benchmark.say(f"the loop in real time at {c.loop.rate_Hz:g} Hz for {seconds:g} s")
    m = measure(c, benchmark, seconds)
    early = "" if m.ending.success else m.ending.reason or m.ending.mode.name
    rows = Log.open(m.closed.path).rows()
    summary = run_figures(rows)
    powered = int(np.count_nonzero((rows["mode"] >= Mode.LOADING) & (rows["mode"] <= Mode.UNLOADING)))
    if not powered:
        raise RunError(f"the run ended before the drives were powered: {early}")
    stale, skipped = summary["stale_ticks"], summary["skipped_ticks"]
    due = len(rows) + skipped
    feedback, command = of_their_tick(*m.bus.latencies(), rows["age"])
    slow = "" if m.granted.fifo else "no SCHED_FIFO"
    answered = spread(feedback, largest=True)
    slack_us = c.loop.window_s(m.rate_Hz) * 1e6 - answered["median"]
    skew = [Figure("SYNC, bus to bus", spread(rows["sync_skew_ns"], largest=True), "us")]
    return [
        *([Figure(EARLY, note=early)] if early else []),
        Figure("rate", {"": m.rate_Hz}, "Hz", note="; ".join(filter(None, (f"{len(rows)} ticks", slow)))),
        Figure("wake-up lateness", summary["wake_up_us"], "us"),
        _beside(c, seconds, slack_us),
        Figure("SYNC to six feedbacks", answered, "us", note="all of their tick, or window over"),
        Figure("SYNC to command sent", spread(command, largest=True), "us"),
        *(skew if c.bus.channels else []),
        Figure("stale ticks", {"": 100.0 * stale / powered}, "%", Mark(0.5), f"{stale} of {powered}"),
        Figure("skipped ticks", {"": 100.0 * skipped / due}, "%", Mark(0.1), f"{skipped} of {due}"),
        *patience_figures(rows, c, shipped),
        Figure("dropped ticks", {"": float(m.closed.dropped + m.closed.lost)}, "", Mark(0.0)),
        Figure("recorder's share of a core", {"": m.recorder_share}, "%", Mark(15.0)),
        compute_figure(rows["compute_ns"][np.isin(rows["mode"], (Mode.APPROACH, Mode.TRACKING))]),
    ]


def _beside(c: Configuration, longest_s: float, slack_us: float) -> Figure:
    name = "  cyclictest beside it"
    seconds = min(CYCLICTEST_S, longest_s)
    found = cyclictest(c.loop.priority, round(1e6 / c.loop.rate_Hz), seconds)
    if isinstance(found, str):
        return Figure(name, note=found)
    note = (
        f"{seconds:g} s, after the run, without load of ours; {found.later_than(slack_us):.2g} % "
        f"later than the {slack_us:.0f} us that the window leaves after six feedbacks"
    )
    return Figure(name, found.percentiles(), "us", note=note)
