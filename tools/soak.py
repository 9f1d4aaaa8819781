"""`make soak`: days of ticks in lockstep, across the wraps of their counters, or half an hour in real time.

A day is made of shifts: each is a run of its own with a log of its own, begins at another tick, and crosses
another wrap soon after. All of them share one process and one folder of logs under a budget.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import click
import yaml

from drivers.arrays import Rows
from drivers.frame_array import sent_at
from hil.app.compose import build_cycle, build_nodes, record
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.yaml_positions import parse
from hil.app.log_budget import GB, dated_logs, make_room, needed_bytes
from hil.app.output import closing, log_path
from hil.app.replay import open_run
from hil.app.sim.build import build_lockstep
from hil.config.reference import TimeOptimalReference, WaypointReference
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.record.mcap_read import read_summary
from hil.signals import TickInput, TickOutput
from tools.benchmarks.figures import Figure, Mark, lines
from tools.benchmarks.process import resident_kB
from tools.benchmarks.timed_cycle import feed

LEAD_S = 2.0
"""A shift begins so long before its wrap: it is crossed in motion."""
SETTLED = 0.25
"""Share of a shift after which memory counts: tables and caches are full."""
GROWTH_MB = 1.0
"""What a shift may add to the memory of a process: its logs and messages come and go. The recorder's share of
the index that a log ends in is not counted: that is held until it is written."""
CHUNK_BYTES = 117
"""Of that index, for each chunk."""
INTERNED = 100_000
"""Names that Python's table of them has seen before the first shift: it grows once, by 2 MB, when some ten
thousand have come and gone, which dozens of runs take. Then it keeps its size."""
_KB_MB = 1 / 1024.0


def wraps(rate_Hz: float) -> dict[str, int]:
    """Return the ticks at which a number no longer fits: a count of ticks, or a time in ns.

    16 bit: of a counter; 31 and 32: of a signed and an unsigned word, after 25 and 50 days at 1 kHz; 53: of
    what a double tells to 1 ns, after 104 days. The next would be 63 bit of ns, after 292 years.
    """
    period_ns = round(1e9 / rate_Hz)
    return {"16 bit": 2**16, "31 bit": 2**31, "32 bit": 2**32, "53 bit of ns": 2**53 // period_ns}


class Memory(NamedTuple):
    """Resident memory of loop and recorder."""

    loop_kB: int
    recorder_kB: int


@dataclass
class Shift:
    """What became of one run."""

    rate_Hz: float
    first: int
    ticks: int
    wall_s: float
    log: Path
    removed: int
    folder_bytes: int
    """All logs of the folder, once this one was closed."""
    dropped: int
    trouble: str
    index_bytes: int = 0
    """Of the log's end, which its recorder holds until then."""
    memory: tuple[Memory, Memory] = (Memory(0, 0), Memory(0, 0))
    """Once it had settled, and at the end; zero where it ended before."""

    @property
    def crossed(self) -> list[str]:
        """Names of the wraps that lie within it."""
        last = self.first + self.ticks - 1
        return [name for name, at in wraps(self.rate_Hz).items() if last // at > self.first // at]

    def grown_MB(self) -> tuple[float, float]:
        """Return by how much loop and recorder, less its index, have grown since they had settled."""
        loop, recorder = (after - before for before, after in zip(*self.memory, strict=True))
        return loop * _KB_MB, recorder * _KB_MB - (1.0 - SETTLED) * self.index_bytes / 2**20


def endless(source: str, folder: Path, budget_GB: float) -> Configuration:
    """Return a configuration whose path repeats without an end, and whose logs share a budget in a folder.

    Raises UsageError: its path cannot repeat so.
    """
    c = load(source)
    if not isinstance(c.reference, WaypointReference | TimeOptimalReference):
        raise click.UsageError(
            f"--configuration {source}: reference.type {c.reference.type} does not repeat without an end; "
            "allowed: waypoints and time_optimal, as virtual has"
        )
    values: dict[str, Any] = dict(parse(c.text).value or {})
    values["reference"]["periods"] = None
    values["recording"] = values.get("recording", {}) | {"folder": str(folder), "budget_GB": budget_GB}
    return loads(yaml.safe_dump(values, sort_keys=False), f"{source}-soak", c.folder)


def first_ticks(rate_Hz: float) -> Iterator[int]:
    """Yield where shifts begin: at 0, then just before each wrap, and so on again."""
    lead = round(LEAD_S * rate_Hz)
    while True:
        yield 0
        yield from (at - lead for at in wraps(rate_Hz).values())


def begun_at(cycle: Cycle, first: int) -> Cycle:
    """Return a controller in its initial state whose first tick is `first`."""
    cycle.reset()
    cycle.mode_tick = first
    return cycle


def controller(c: Configuration, first: int) -> Cycle:
    """Return the controller of a configuration, whose first tick is `first`."""
    return begun_at(build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms), first)


def looks(first: int, until: int) -> tuple[int, int]:
    """Return the ticks at which memory is looked at: once it has settled, and the last one before `until`."""
    return first + round(SETTLED * (until - first)), until - 1


def work(c: Configuration, first: int, seconds: float) -> Shift:
    """Run a shift of so many simulated seconds, and record it."""
    rate_Hz = c.loop.rate_Hz
    cycle, until = controller(c, first), first + round(seconds * rate_Hz)
    path = log_path(c.recording.folder, c.name, None)
    removed = make_room(c, needed_bytes(c, None, seconds))
    nodes, physics = build_nodes(c)
    settled, last = looks(first, until)
    memory = [Memory(0, 0), Memory(0, 0)]
    try:
        lockstep = build_lockstep(c, cycle, nodes, first)
        with record(c, cycle, path, "sim", lockstep=True) as recording, collector_paused():
            recorder = recording._process.pid  # noqa: SLF001 - seen from outside

            def observe(inp: TickInput, opening: Rows, out: TickOutput) -> None:
                sent = sent_at(inp.t_ns, opening, out.frames)
                recording.tick_of_items(out.row, inp.frames, sent, inp.operator)
                if inp.tick in (settled, last):
                    memory[inp.tick == last] = Memory(resident_kB(os.getpid()), resident_kB(recorder))

            begun = time.perf_counter()
            ending = lockstep.run(until / rate_Hz, observe, recording.event)
            wall_s = time.perf_counter() - begun
            closed = recording.close(closing(ending, ending.trouble))
    finally:
        physics.close()
        gc.collect()
    total = sum(each.size for each in dated_logs(path.parent, c.name))
    trouble = ending.trouble or closed.error
    lost = closed.dropped + closed.lost
    index = 0 if closed.error else read_summary(path)[0].chunk_count * CHUNK_BYTES
    return Shift(
        rate_Hz,
        first,
        closed.ticks,
        wall_s,
        path,
        len(removed),
        total,
        lost,
        trouble,
        index,
        (memory[0], memory[1]),
    )


def differences(shift: Shift) -> tuple[int, int]:
    """Run the log of a shift through the same code; return its ticks, and how many of them differ."""
    log, run, c = open_run(shift.log)
    del run
    cycle, ticks, different = controller(c, shift.first), 0, 0
    with collector_paused():
        for entry in log.ticks():
            whole = int(entry.row["tick"]) == shift.first + ticks
            ticks, different = ticks + 1, different + (bool(feed((entry,), cycle)) or not whole)
    return ticks, different + abs(shift.ticks - ticks)


def soak(c: Configuration, hours: float, shift_s: float) -> Iterator[Shift]:
    """Yield shifts until so many hours are simulated."""
    for k in range(INTERNED):
        sys.intern(f"name {k}")
    left = hours * 3600.0
    for first in first_ticks(c.loop.rate_Hz):
        yield work(c, first, min(shift_s, left))
        left -= shift_s
        if left <= 1e-9:
            return


def last_hour(shifts: list[Shift], rate_Hz: float) -> list[Shift]:
    """Return the last shifts, up to an hour of them, whose logs are there."""
    found: list[Shift] = []
    for each in reversed(shifts):
        if not each.log.exists() or sum(s.ticks for s in found) >= 3600.0 * rate_Hz:
            break
        found.append(each)
    return found


def figures(shifts: list[Shift], c: Configuration, compared: list[tuple[int, int]]) -> list[Figure]:
    """Return what is judged of shifts; compared: what `differences` gives of those of the last hour."""
    rate_Hz, ticks = c.loop.rate_Hz, sum(s.ticks for s in shifts)
    wall_s = sum(s.wall_s for s in shifts)
    budget_GB = c.recording.budget_GB
    assert budget_GB is not None
    grown = [s.grown_MB() for s in shifts]
    crossed = {name: sum(name in s.crossed for s in shifts) for name in wraps(rate_Hz)}
    enough = len(shifts) > len(crossed)  # a shift that begins at 0, and one at each of them
    ends_kB = [s.memory[1].loop_kB for s in shifts]
    between = (ends_kB[-1] - ends_kB[min(1, len(shifts) - 1)]) * _KB_MB
    largest = max(s.folder_bytes for s in shifts) / GB
    trouble = "; ".join(dict.fromkeys(s.trouble for s in shifts if s.trouble))
    kept = f"{len(shifts)} logs written, {sum(s.removed for s in shifts)} removed"
    return [
        Figure("simulated", {"": ticks / rate_Hz / 3600.0}, "h", note=f"{ticks} ticks, {len(shifts)} shifts"),
        Figure("speed", {"": ticks / rate_Hz / wall_s}, "times real time"),
        Figure(
            "shifts that did not end well", {"": _count(s.trouble for s in shifts)}, "", Mark(0.0), trouble
        ),
        Figure("counter of SYNC, 8 bit", {"": float(sum(s.ticks // 256 for s in shifts))}, "wraps"),
        *(
            Figure(f"number of ticks, {name}", {"": float(n)}, "wraps", Mark(1.0, False) if enough else None)
            for name, n in crossed.items()
        ),
        Figure("loop, growth in a shift", {"most": max(g[0] for g in grown)}, "MB", Mark(GROWTH_MB)),
        Figure(
            "recorder, growth in a shift",
            {"most": max(g[1] for g in grown)},
            "MB",
            Mark(GROWTH_MB),
            f"beyond the index of its log, {max(s.index_bytes for s in shifts) / 2**20:.2f} MB",
        ),
        Figure("process, second shift to last", {"": between}, "MB", Mark(GROWTH_MB)),
        Figure("logs of the folder", {"most": largest}, "GB", Mark(budget_GB), kept),
        Figure("dropped ticks", {"": float(sum(s.dropped for s in shifts))}, "", Mark(0.0)),
        Figure(
            "replayed", {"": float(sum(n for n, _ in compared))}, "ticks", Mark(1.0, False), "the last hour"
        ),
        Figure("ticks that differ", {"": float(sum(n for _, n in compared))}, "", Mark(0.0)),
    ]


def _count(texts: Iterator[str]) -> float:
    return float(sum(bool(text) for text in texts))


def real(c: Configuration, minutes: float) -> list[Figure]:
    """Run the daemon with its plant for so long, as users start it; return what is judged of it."""
    folder = Path(c.recording.folder)
    source, told = folder / f"{c.name}.yaml", folder / "summary.json"
    source.write_text(c.text)
    words = ("run", str(source), "--plant", "--arm", "--duration", f"{60.0 * minutes:g}", "--json", str(told))
    process = subprocess.Popen([sys.executable, "-m", "hil.cli", *words], stdout=subprocess.DEVNULL)
    seen: list[int] = []
    over = time.monotonic() + 60.0 * minutes
    try:
        while process.poll() is None:
            if time.monotonic() < over:  # afterwards it reads and replays its log
                seen.append(resident_kB(process.pid))
            time.sleep(1.0)
    finally:
        process.terminate()
        process.wait()
    summary: dict[str, Any] = json.loads(told.read_text()) if told.exists() else {}
    settled = seen[int(SETTLED * (len(seen) - 1)) :] or [0]
    replay = summary.get("replay", {})
    names = {"success": summary.get("success"), "exact replay": replay.get("agrees")}
    return [
        Figure("in real time", {"": minutes}, "min", note=f"{summary.get('ticks', 0)} ticks"),
        *(Figure(name, {"": float(bool(value))}, "", Mark(1.0, False)) for name, value in names.items()),
        Figure("dropped ticks", {"": float(summary.get("dropped_ticks", "nan"))}, "", Mark(0.0)),
        Figure("loop, growth", {"": (settled[-1] - settled[0]) * _KB_MB}, "MB", Mark(GROWTH_MB)),
    ]


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--hours", type=click.FloatRange(min=0, min_open=True), default=24.0, show_default=True)
@click.option("--shift-minutes", type=click.FloatRange(min=0.05), default=15.0, show_default=True)
@click.option("--budget-GB", type=click.FloatRange(min=0.07), default=8.0, show_default=True)
@click.option("--configuration", default="virtual", show_default=True)
@click.option("--folder", type=click.Path(path_type=Path), default=Path("build/soak"), show_default=True)
@click.option("--real", "real_minutes", type=click.FloatRange(min=0.1), help="Minutes in real time instead.")
def main(
    hours: float,
    shift_minutes: float,
    budget_gb: float,
    configuration: str,
    folder: Path,
    real_minutes: float | None,
) -> None:
    """Run for long, and print what memory, logs, counters and replay made of it.

    Exit code 1 where a mark is missed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    c = endless(configuration, folder, budget_gb)
    if real_minutes is not None:
        found = real(c, real_minutes)
    else:
        shifts = []
        for each in soak(c, hours, 60.0 * shift_minutes):
            shifts.append(each)
            crossed = f", crossed {', '.join(each.crossed)}" if each.crossed else ""
            print(
                f"from tick {each.first}: {each.ticks} ticks in {each.wall_s:.0f} s{crossed} {each.trouble}"
            )
            sys.stdout.flush()
        found = figures(shifts, c, [differences(s) for s in last_hour(shifts, c.loop.rate_Hz)])
    print("\n".join(lines("soak", found)))
    sys.exit(0 if all(each.met is not False for each in found) else 1)


if __name__ == "__main__":
    main()
