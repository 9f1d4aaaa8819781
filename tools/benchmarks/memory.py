"""Resident memory of the daemon, seen from outside: `hil run` as users start it."""

import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO

from drivers.errors import RunError
from hil.record.log import Log
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, Mark
from tools.benchmarks.patience import patience_figures
from tools.benchmarks.process import resident_kB

SETTLE_S = 10.0
"""Engaging, and the first periods of the path; no longer than the memory is watched."""
START_S = 90.0
CLOSE_S = 300.0
"""The log of a long run is read and replayed before the daemon ends."""
MARK_MINUTES = 10.0


def memory(benchmark: Benchmark) -> list[Figure]:
    """Run the daemon with its plant, and look at its memory once a second."""
    c = benchmark.endless
    minutes = benchmark.memory_minutes
    settle_s = min(SETTLE_S, minutes * 60.0)
    log = benchmark.folder / "memory.mcap"
    benchmark.say(f"memory of hil run for {minutes:g} min, after {settle_s:g} s to settle")
    command = [sys.executable, "-m", "hil.cli", "run", c.source, "--plant", "--arm", "--log", str(log)]
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=output, start_new_session=True)
        try:
            _wait_for(log, process, output)
            time.sleep(settle_s)
            samples = _watch(process, minutes * 60.0, output)
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(CLOSE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        if process.returncode:
            raise RunError(_ended(process, output))
    rows = Log.open(log).rows()
    return memory_figures(samples, minutes) + patience_figures(rows, c, benchmark.configuration)


def memory_figures(samples_kB: list[int], minutes: float) -> list[Figure]:
    """Return peak and growth; a shorter run than the mark's is extrapolated, and says so."""
    short = minutes < MARK_MINUTES
    grown_MB = (samples_kB[-1] - samples_kB[0]) / 1024.0
    figures = [
        Figure("daemon, resident", {"": max(samples_kB) / 1024.0}, "MB", Mark(300.0)),
        Figure(f"its growth in {minutes:g} min", {"": grown_MB}, "MB", None if short else Mark(2.0)),
    ]
    if short:
        each = grown_MB / minutes * MARK_MINUTES
        note = f"EXTRAPOLATED from {minutes:g} min; --memory-minutes {MARK_MINUTES:g} measures it"
        figures.append(Figure(f"  in {MARK_MINUTES:g} min", {"": each}, "MB", Mark(2.0), note))
    return figures


def _wait_for(log: Path, process: subprocess.Popen[bytes], output: IO[bytes]) -> None:
    """Wait until the recorder has opened the log: the loop begins next."""
    end = time.monotonic() + START_S
    while not log.exists():
        if process.poll() is not None:
            raise RunError(_ended(process, output))
        if time.monotonic() > end:
            raise RunError(f"hil run has not begun within {START_S:g} s")
        time.sleep(0.1)


def _watch(process: subprocess.Popen[bytes], seconds: float, output: IO[bytes]) -> list[int]:
    """Return the resident memory once a second, first and last instant included, kB."""
    begun = time.monotonic()
    samples = []
    while True:
        if process.poll() is not None:
            raise RunError(_ended(process, output))
        samples.append(resident_kB(process.pid))
        rest = begun + seconds - time.monotonic()
        if rest <= 0:
            return samples
        time.sleep(min(1.0, rest))


def _ended(process: subprocess.Popen[bytes], output: IO[bytes]) -> str:
    output.seek(0)
    text = output.read().decode(errors="replace").strip()
    return f"hil run ended with exit code {process.returncode}: {text[-2000:]}"
