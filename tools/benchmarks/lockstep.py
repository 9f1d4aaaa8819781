"""Speed of `hil sim`, `hil replay`, a constantly fed recorder and a step of the FMU, none in real time."""

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

from drivers.arrays import Array
from hil.app.compose import attachments, build_nodes, build_scene
from hil.app.replay import replay_log
from hil.record import Recording
from plant_fmu.fmu.call import do_step
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.plant import Plant
from tools.benchmarks.benchmark import Benchmark, Figure, Mark, cpu_s, spread

TICKS = 12_000
"""Number of ticks, less than RING, so that none is dropped however slow the recorder is."""
RING = 16_384
FAST = Mark(10.0, at_most=False)
"""Smallest allowed speed, as a multiple of real time."""
STEPS = 4000
STRETCH = 200
"""Number of steps between two resets: the legs move freely and must not reach their end stops."""
STEP_S = 1e-3
REST = np.zeros(6)
_now = time.perf_counter_ns


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


def fmu(benchmark: Benchmark) -> list[Figure]:
    """Measure 1 ms steps of the FMU, with leg forces that carry the weight and open brakes."""
    benchmark.say("the FMU, in process and in a child process")
    cycle = benchmark.cycle()
    force = cycle.effort.model.inverse_dynamics(cycle.parts.home_p, cycle.parts.home_R, REST, REST)
    _, host = build_nodes(benchmark.configuration)
    assert isinstance(host, FmuHost)
    with closing(host), closing(ChildHost(host.spec)) as child:
        call = host._record  # noqa: SLF001 - the C call without the host around it
        ticks = round(STEP_S / host.internal_step_s)

        def in_C(k: int) -> None:
            assert do_step(call, k * ticks * host.internal_step_s, STEP_S) == 0

        alone = _times(host, force, in_C)
        hosted, apart = (_times(plant, force) for plant in (host, child))
    step, here, there = (float(np.median(times)) for times in (alone, hosted, apart))
    return [
        Figure("1 ms step in C", spread(alone), "us", Mark(30.0), f"{ticks} internal steps"),
        Figure("hosted, in process", spread(hosted), "us"),
        Figure("  hosting, medians", {"": (here - step) * 1e-3}, "us", Mark(6.0), "with inputs, outputs"),
        Figure("hosted, child process", spread(apart), "us"),
        Figure("  hosting, medians", {"": (there - step) * 1e-3}, "us"),
    ]


def _times(plant: Plant, force: Array, step: Callable[[int], None] | None = None) -> list[int]:
    """Durations of steps, ns: of `Plant.step`, or of `step`, called with steps since the last reset."""
    took = []
    for k in range(STEPS):
        if k % STRETCH == 0:
            plant.reset()
            plant.step(force, REST, REST, STEP_S)
        begun = _now()
        if step is None:
            plant.step(force, REST, REST, STEP_S)
        else:
            step(1 + k % STRETCH)
        took.append(_now() - begun)
    return took
