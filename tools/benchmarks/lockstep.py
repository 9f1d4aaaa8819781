"""Speed of `hil sim`, of `hil replay`, and of a recorder with constant input, none in real time."""

import time
from pathlib import Path

import numpy as np

from hil.app.compose import attachments, build_scene
from hil.app.replay import replay_log
from hil.record import Recording
from tools.benchmarks.benchmark import Benchmark, cpu_s
from tools.benchmarks.figures import Figure, Mark, spread

TICKS = 12_000
"""Number of ticks, less than RING, so that none is dropped however slow the recorder is."""
RING = 16_384
FAST = Mark(10.0, at_most=False)
"""Smallest allowed speed, as a multiple of real time."""


def simulation(benchmark: Benchmark) -> list[Figure]:
    """Measure `hil sim`: both ends of the bus in one process, with recording."""
    summary = benchmark.simulated
    note = f"{summary['ticks']} ticks, recording on, first to last tick"
    factor = {"": summary["real_time_factor"]}
    return [Figure("real-time factor of hil sim virtual", factor, "times", FAST, note)]


def replaying(benchmark: Benchmark) -> list[Figure]:
    """Measure the replay of the simulated run's log."""
    log = Path(benchmark.simulated["log"])
    benchmark.say(f"hil replay {log.name}")
    comparison, summary = replay_log(log)
    note = f"{comparison.ticks} ticks, {comparison.different_ticks} differences"
    return [Figure("speed of hil replay", {"": summary["times_real_time"]}, "times real time", FAST, note)]


def recorder(benchmark: Benchmark) -> list[Figure]:
    """Measure a recorder that gets the ticks of the simulated run without pause."""
    entries = benchmark.ticks[:TICKS]
    c = benchmark.configuration
    benchmark.say(f"{len(entries)} ticks into the recorder")
    recording = Recording.start(
        benchmark.folder / "recorder.mcap",
        configuration=c.text,
        attachments=attachments(c),
        scene=build_scene(c),
        can_channel=c.bus.channel,
        ring_ticks=RING,
    )
    with recording:
        before = cpu_s(recording.process.pid)
        ready = [(np.array(e.row), e.received, e.sent, e.operator) for e in entries]
        took = []
        begun = time.perf_counter()
        for row, received, sent, operator in ready:
            start = time.perf_counter_ns()
            recording.tick(row, received, sent, operator)
            took.append(time.perf_counter_ns() - start)
        closed = recording.close()
        wall = time.perf_counter() - begun
    each = (closed.recorder_cpu_s - before) / len(entries) * 1e6
    return [
        Figure("recorder, a tick", {"": each}, "us CPU", note=f"{1e6 / each:.0f} ticks/s at most"),
        Figure("its share of a core at 1 kHz", {"": each / 10.0}, "%", Mark(15.0), note="computed from that"),
        Figure("its throughput, closing included", {"": closed.ticks / wall}, "ticks/s"),
        Figure("dropped ticks", {"": float(closed.dropped + closed.lost)}, "", Mark(0.0)),
        Figure("the loop's part, a tick", spread(took), "us"),
        Figure("size of the log, a tick", {"": closed.size_bytes / max(1, closed.ticks)}, "bytes"),
    ]
