"""`make bench`: speed of the parts of the project, each figure with its limit, called mark.

A benchmark, not a test: it exits 0 whatever the figures are, and 1 if a part could not be measured. The
marks are for two idle cores with SCHED_FIFO.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from drivers.errors import HilError
from hil.app.output import check_json_path, write_json
from hil.loop.clock import fifo_allowed
from hil.record import environment
from tools.benchmarks.benchmark import EARLY, FAILED, Benchmark, Figure, lines
from tools.benchmarks.live import realtime, two_buses
from tools.benchmarks.lockstep import fmu, recorder, replaying, simulation
from tools.benchmarks.tick import tick

PARTS: dict[str, tuple[Callable[[Benchmark], list[Figure]], str]] = {
    "realtime": (realtime, "real time: hil run virtual at 1 kHz against its plant on localcan"),
    "two_buses": (two_buses, "real time: the loop at 2 kHz on two buses, as this machine allows"),
    "tick": (tick, "tick compute, hot: recorded ticks back to back, and the share of the control law"),
    "simulation": (simulation, "lockstep"),
    "replay": (replaying, "replay"),
    "recorder": (recorder, "recorder, fed without pause"),
    "fmu": (fmu, "FMU"),
}
"""Name -> function that measures the part, and its title; in the order in which they run."""


def machine(priority: int) -> dict[str, str]:
    """CPU, cores, kernel, scheduler of the loop and Python version of this machine, as text."""
    found = environment()
    return {
        "cpu": found.get("cpu", "unknown CPU"),
        "cores": found.get("cpus", "?"),
        "kernel": found.get("kernel", "unknown kernel").split()[0],
        "scheduler": f"SCHED_FIFO {priority}" if fifo_allowed(priority) else "no SCHED_FIFO",
        "python": found["python"],
    }


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--only", type=click.Choice(list(PARTS)), help="Run one part.")
@click.option(
    "--seconds", type=click.FloatRange(min=0, min_open=True), default=60.0, show_default=True,
    help="Length of the runs; on two buses at most 20 s, simulated to the end of the path.",
)  # fmt: skip
@click.option(
    "--json", "json_file", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Also write the figures to this file.",
)  # fmt: skip
def main(only: str | None, seconds: float, json_file: Path | None) -> None:
    """Measure this machine: compute, laws, wake-ups, latency, recorder, replay, FMU.

    The limits (marks) are for two idle cores with SCHED_FIFO. Logs go to a folder under runs/ that is
    removed at the end.
    """
    try:
        if json_file is not None:
            check_json_path(json_file)
        summary = run_parts([only] if only else list(PARTS), seconds)
        if json_file is not None:
            write_json(json_file, summary)
    except HilError as error:
        click.echo(f"benchmark: {error}", err=True)
        sys.exit(2)
    sys.exit(0 if summary["success"] else 1)


def run_parts(names: list[str], seconds: float) -> dict[str, Any]:
    """Run parts of the benchmark, print each when it is measured, and return all figures as plain values.

    A part that fails prints its reason and does not stop the others.
    Raises HilError if the benchmark cannot begin.
    """
    runs = Path("runs")
    runs.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="benchmark-", dir=runs, ignore_cleanup_errors=True) as folder:
        benchmark = Benchmark(Path(folder), seconds, lambda text: click.echo(f"... {text}", err=True))
        here = machine(benchmark.configuration.loop.priority)
        click.echo(f"{', '.join(v if k != 'cores' else f'{v} cores' for k, v in here.items())}\n")
        parts: dict[str, list[Figure]] = {}
        for name in names:
            measure, title = PARTS[name]
            try:
                parts[name] = measure(benchmark)
            except HilError as error:
                parts[name] = [Figure(FAILED, note=str(error))]
            click.echo("\n".join(lines(title, parts[name])) + "\n")
    judged = [f for figures in parts.values() for f in figures if f.met is not None]
    missed = [f for f in judged if not f.met]
    click.echo(f"{len(judged) - len(missed)} of {len(judged)} marks met")
    failed = [name for name, figures in parts.items() if any(f.name in (FAILED, EARLY) for f in figures)]
    return {
        "success": not failed,
        "kind": "benchmark",
        "machine": here,
        "marks_met": len(judged) - len(missed),
        "marks": len(judged),
        "parts": {name: [f.plain() for f in figures] for name, figures in parts.items()},
    }


if __name__ == "__main__":
    main()
