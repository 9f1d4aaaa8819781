"""`make soak`: days of ticks in lockstep, across the wraps of their counters.

A soak consists of shifts. Each shift is a run that begins shortly before another wrap of a counter and is
replayed. All shifts share one process.
"""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from mcap.reader import make_reader

from drivers.frame_array import NO_FRAMES
from hil.app.compose import build_cycle, build_nodes, record
from hil.app.configuration.configuration import Configuration
from hil.app.output import end_record
from hil.app.sim.build import build_lockstep
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.tick_row import Given, Ticks
from hil.record.log import Log
from tools.benchmarks.benchmark import Figure, Mark, lines, patient, resident_MB
from tools.benchmarks.tick import steps

LEAD_S = 2.0
"""Time, s, from the start of a shift to the overflow of a counter, which then happens in motion."""
SETTLED = 0.25
"""Share of a shift after which memory counts: tables and caches are full by then."""
GROWTH = Mark(1.0)
"""MB by which the memory of a process may grow in a shift: its logs and messages come and go."""
CHUNK_MB = 117 / 2**20
"""Memory of the recorder for each chunk of a log, MB: it keeps the index until the end of the log."""
INTERNED = 100_000
"""Number of names that are interned before the first shift. Python's table of names grows once by 2 MB, after
some ten thousand names, which dozens of runs take; then its size is constant."""


def wraps(rate_Hz: float) -> dict[str, int]:
    """Ticks at which a number overflows: a count of ticks, or a time in ns.

    16 bit: a counter; 31 and 32: a signed and an unsigned word, after 25 and 50 days at 1 kHz; 53: a time
    that a double resolves to 1 ns, after 104 days. The next would be 63 bit of ns, after 292 years.
    """
    return {"16 bit": 2**16, "31 bit": 2**31, "32 bit": 2**32, "53 bit of ns": 2**53 // round(1e9 / rate_Hz)}


class Shift(NamedTuple):
    """Result of one shift, a simulated and replayed run."""

    first: int
    ticks: int
    crossed: list[str]
    """Names of the counters that overflowed during the run."""
    wall_s: float
    trouble: str
    different: int
    """Number of ticks that differ in a replay."""
    grown_MB: tuple[float, float]
    """Memory growth of loop and recorder after they had settled; that of the recorder without its index."""
    held: tuple[float, int] = (0.0, 0)
    """MB and number of open files of this process at the end."""


def first_ticks(rate_Hz: float) -> Iterator[int]:
    """Yield the first ticks of shifts, endlessly: 0, then one shortly before each counter's overflow."""
    lead = round(LEAD_S * rate_Hz)
    while True:
        yield 0
        yield from (at - lead for at in wraps(rate_Hz).values())


def _controller(c: Configuration, first: int) -> Cycle:
    """New controller in its initial state, whose first tick has the number `first`."""
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    cycle.reset()
    cycle.mode_tick = first
    return cycle


def shift(c: Configuration, first: int, seconds: float, log: Path) -> Shift:
    """Simulate, record and replay `seconds` from tick `first` on; delete the log if all is correct."""
    rate_Hz = c.loop.rate_Hz
    until = first + round(seconds * rate_Hz)
    looks = first + round(SETTLED * (until - first)), until - 1
    seen: list[tuple[float, float]] = []
    nodes, physics = build_nodes(c)
    try:
        lockstep = build_lockstep(c, _controller(c, first), nodes, first)
        with record(c, lockstep.cycle, log, "sim", lockstep=True) as recording, collector_paused():
            pids = os.getpid(), recording.process.pid

            def take(ticks: Ticks, new: slice, given: Given) -> None:
                rows, frames, ends = ticks.recorded(new)
                if any(given):
                    operator, orders, setpoints = given
                    recording.tick(rows[0], frames, NO_FRAMES, operator, setpoints, orders)
                else:
                    recording.ticks_of_items(rows, frames, ends)
                if any(rows["tick"][0] <= look <= rows["tick"][-1] for look in looks):
                    seen.append((resident_MB(pids[0]), resident_MB(pids[1])))

            begun = time.perf_counter()
            ending = lockstep.run(until / rate_Hz, None, recording.event, take=take)
            wall_s = time.perf_counter() - begun
            closed = recording.close(end_record(ending, ending.trouble))
    finally:
        physics.close()
    lost = closed.dropped + closed.lost
    trouble = ", ".join(filter(None, (ending.trouble, closed.error, f"{lost} ticks lost" if lost else "")))
    different = 0 if closed.error else differences(c, first, log)
    chunks = 0 if closed.error else _chunks(log)
    loop, recorder = (b - a for a, b in zip(seen[0], seen[-1], strict=True)) if seen else (0.0, 0.0)
    if not (trouble or different):
        log.unlink()
    gc.collect()
    last = first + closed.ticks - 1
    crossed = [name for name, at in wraps(rate_Hz).items() if last // at > first // at]
    grown = loop, recorder - (1.0 - SETTLED) * chunks * CHUNK_MB
    held = resident_MB(os.getpid()), len(list(Path("/proc/self/fd").iterdir()))
    return Shift(first, closed.ticks, crossed, wall_s, trouble, different, grown, held)


def _chunks(path: Path) -> int:
    """Number of chunks in a log, by its index."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    return len(summary.chunk_indexes) if summary else 0


def differences(c: Configuration, first: int, path: Path) -> int:
    """Replay a log from its first tick on; count ticks that differ or are missing."""
    log = Log.open(path)
    ticks = log.rows("tick")["tick"]
    missing = int(np.count_nonzero(ticks != first + np.arange(len(ticks))))
    with collector_paused():
        return missing + sum(not step.same for step in steps(log.ticks(), _controller(c, first)))


def figures(shifts: list[Shift], rate_Hz: float) -> list[Figure]:
    """Results over all shifts, each with its limit (mark)."""
    ticks, wall_s = sum(s.ticks for s in shifts), sum(s.wall_s for s in shifts)
    trouble = [s.trouble for s in shifts if s.trouble]
    crossed = {name: sum(name in s.crossed for s in shifts) for name in wraps(rate_Hz)}
    whole = Mark(1.0, at_most=False) if len(shifts) > len(crossed) else None  # one at 0, and one at each
    loop, recorder = (max(grown) for grown in zip(*(s.grown_MB for s in shifts), strict=True))
    MB, files = (after - before for before, after in zip(shifts[:2][-1].held, shifts[-1].held, strict=True))
    return [
        Figure("simulated", {"": ticks / rate_Hz / 3600.0}, "h", note=f"{ticks} ticks, {len(shifts)} shifts"),
        Figure("speed", {"": ticks / rate_Hz / wall_s}, "times real time"),
        Figure("shifts in trouble", {"": float(len(trouble))}, "", Mark(0.0), "; ".join(trouble)),
        *(Figure(f"number of ticks, {name}", {"": float(n)}, "wraps", whole) for name, n in crossed.items()),
        Figure("ticks that differ", {"": float(sum(s.different for s in shifts))}, "", Mark(0.0)),
        Figure("loop, growth in a shift", {"most": loop}, "MB", GROWTH),
        Figure("recorder, growth in a shift", {"most": recorder}, "MB", GROWTH, "without its index"),
        Figure("process, second shift to last", {"": MB}, "MB", GROWTH),
        Figure("open files, second shift to last", {"": float(files)}, "", Mark(0.0)),
    ]


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--hours", type=click.FloatRange(min=0, min_open=True), default=24.0, show_default=True)
@click.option("--shift-minutes", type=click.FloatRange(min=0.05), default=15.0, show_default=True)
@click.option("--configuration", default="virtual", show_default=True)
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/soak"), show_default=True)
def main(hours: float, shift_minutes: float, configuration: str, folder: Path) -> None:
    """Run for a long time, and print the effects on memory, open files, counters and replay.

    Exit code 1 if a result misses its limit, called mark.
    """
    folder.mkdir(parents=True, exist_ok=True)
    c = patient(configuration, folder, 60.0 * shift_minutes)
    for k in range(INTERNED):
        sys.intern(f"name {k}")
    shifts: list[Shift] = []
    left, firsts = hours * 3600.0, first_ticks(c.loop.rate_Hz)
    while left > 1e-9:
        log = folder / f"{len(shifts)}.mcap"
        one = shift(c, next(firsts), min(60.0 * shift_minutes, left), log)
        shifts.append(one)
        left -= 60.0 * shift_minutes
        text = f"from tick {one.first}: {one.ticks} ticks in {one.wall_s:.0f} s"
        print("; ".join(filter(None, (text, *one.crossed, one.trouble))), flush=True)
    found = figures(shifts, c.loop.rate_Hz)
    print("\n".join(lines("soak", found)))
    sys.exit(0 if all(each.met is not False for each in found) else 1)


if __name__ == "__main__":
    main()
