"""Timing of `hil run` with its plant in real time, as users start it, from the log."""

import json
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import RunError
from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration, load
from hil.record.log import Log
from tools.benchmarks.benchmark import EARLY, Benchmark, Figure, Mark, patient, spread
from tools.benchmarks.tick import COMPUTE

TWO_BUSES_S = 20.0
ENDS_S = 300.0
"""Time limit for start, parking and replay; a run that a fault prevents from parking does not end."""


def live_run(c: Configuration, seconds: float, folder: Path) -> dict[str, Any]:
    """Run the daemon with its plant for `seconds`; return the summary.

    c must be loaded from a file; log and summary go into a new folder in `folder`. Raises RunError if the run
    leaves no summary.
    """
    made = Path(tempfile.mkdtemp(dir=folder))
    summary_file = made / "run.json"
    words = f"--plant --arm --duration {seconds:g} --log {made}/run.mcap --json {summary_file}".split()
    command = [sys.executable, "-m", "hil.cli", "run", c.source, *words]
    with tempfile.TemporaryFile() as errors:
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                timeout=seconds + ENDS_S,
                check=False,
            )
        if not summary_file.exists():
            errors.seek(0)
            raise RunError(f"hil run: no summary: {errors.read().decode(errors='replace').strip()[-2000:]}")
    return dict(json.loads(summary_file.read_text()))


def realtime(benchmark: Benchmark) -> list[Figure]:
    """Measure the loop in real time, with the plant in a second process and the recorder in a third.

    Raises RunError if the run never powered the drives.
    """
    return _figures(benchmark, "virtual", benchmark.seconds)


def two_buses(benchmark: Benchmark) -> list[Figure]:
    """Measure the loop at 2 kHz on two buses, as far as this machine allows; figures have no limits."""
    found = _figures(benchmark, "two_buses", min(TWO_BUSES_S, benchmark.seconds))
    return [replace(each, mark=None) for each in found]


def _figures(benchmark: Benchmark, name: str, seconds: float) -> list[Figure]:
    c, shipped = patient(name, benchmark.folder, seconds), load(name).limits
    benchmark.say(f"hil run {name} at {c.loop.rate_Hz:g} Hz for {seconds:g} s")
    summary = live_run(c, seconds, benchmark.folder)
    log = Log.open(Path(summary["log"]))
    rows = log.rows()
    powered = rows[(rows["mode"] >= Mode.LOADING) & (rows["mode"] <= Mode.UNLOADING)]
    if not len(powered):
        raise RunError(f"the run ended before the drives were powered: {summary['trouble']}")
    stale, skipped = summary["stale_ticks"], summary["skipped_ticks"]
    missing = summary["real_time"]["missing"]
    moving = np.isin(rows["mode"], (Mode.APPROACH, Mode.TRACKING))
    answered = [
        max(frame.t_ns for frame in tick.received) - int(tick.row["t_ns"] + tick.row["lateness_ns"])
        for tick in log.ticks()
        if tick.received and not tick.row["age"].any()
    ]
    missed = np.bincount(np.cumsum(powered["skipped"] == 0), powered["skipped"])
    skew = Figure("SYNC, bus to bus", spread(rows["sync_skew_ns"], largest=True), "us")
    return [
        *([] if summary["success"] else [Figure(EARLY, note=str(summary["trouble"]))]),
        Figure("rate", {"": summary["rate_Hz"]}, "Hz", note="; ".join((f"{len(rows)} ticks", *missing))),
        Figure("wake-up lateness", summary["wake_up_us"], "us"),
        Figure("wake-up to six feedbacks", spread(answered, largest=True), "us", note="their end on the bus"),
        *([skew] if c.bus.channels else []),
        _share("stale ticks", stale, len(powered), 0.5),
        _share("skipped ticks", skipped, len(rows) + skipped, 0.1),
        _lost("longest age of a leg's data", powered["age"].max(), shipped.stale_fault_ticks),
        _lost("longest run of missed periods", missed.max(), shipped.missed_stop_ticks),
        Figure("dropped ticks", {"": float(summary["dropped_ticks"])}, "", Mark(0.0)),
        Figure("tick compute", spread(rows["compute_ns"][moving]), "us", COMPUTE),
    ]


def _share(name: str, count: int, of: int, most: float) -> Figure:
    return Figure(name, {"": 100.0 * count / of}, "%", Mark(most), f"{count} of {of}")


def _lost(name: str, ticks: float, limit: int) -> Figure:
    return Figure(f"  {name}", {"": float(ticks)}, "ticks", note=f"the shipped limit, {limit}, ends a run")
