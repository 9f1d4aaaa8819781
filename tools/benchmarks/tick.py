"""Compute time of one tick with warm caches: the whole control step, and the part of each law."""

import gc
import time
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from drivers.arrays import Ints
from drivers.errors import RunError
from drivers.frame_array import joined, sent_frames
from drivers.signals import LEGS, DriveState, Mode
from drivers.tick_columns import Record, copy_of, new_record
from hil.app.configuration.controller_file import controller_of
from hil.control.law import LawContext
from hil.control.state_space import StateSpaceSettings
from hil.estimation.pose import Estimator
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.reference import fill_reference
from hil.loop.replay import recorded_input
from hil.record.log import Tick
from hil.study.compare.laws import chosen
from tools.benchmarks.benchmark import Benchmark, Figure, Mark, spread

COMPUTE = Mark(40.0)
"""Limit of a tick's compute time, us, from received frames to frames to send and the row."""
SLEEP_S = 1e-5
"""Shortest possible sleep, s; its real duration does not matter."""
BLOCK = 100
"""Number of ticks in a block; other processes disturb some blocks and not others."""
PATH_TICKS = 2000
"""Ticks of one period of the path at 1 kHz."""
OFF = np.full(LEGS, 1e-4)
"""Distance of the legs from the path, m."""
_now = time.perf_counter_ns


class Step(NamedTuple):
    """Result of computing one recorded tick again."""

    mode: Mode
    took_ns: int
    same: bool
    """True if frames and row are as recorded, to the bit."""


def steps(entries: Iterable[Tick], cycle: Cycle, sleep_s: float = 0.0) -> Iterator[Step]:
    """Compute recorded ticks again, one by one, with a controller; sleep before each if `sleep_s` > 0."""
    for entry in entries:
        inp = recorded_input(entry)
        opening = cycle.begin(inp.tick)
        if sleep_s:
            time.sleep(sleep_s)
        begun = _now()
        out = cycle.step(inp)
        took = _now() - begun
        same = sent_frames(joined((opening, out.frames))) == entry.sent
        yield Step(cycle.mode, took, same and out.row.tobytes() == entry.row.tobytes())


def tick(benchmark: Benchmark) -> list[Figure]:
    """Measure the compute time of a tick, on the recorded inputs of the simulated run, and of each law."""
    benchmark.say(f"{len(benchmark.ticks)} ticks from memory, twice through the cycle")
    whole, slept = (_tracking(benchmark, sleep_s) for sleep_s in (0.0, SLEEP_S))
    blocks = whole[: len(whole) // BLOCK * BLOCK].reshape(-1, BLOCK)
    quietest = blocks[np.median(blocks, axis=1).argmin()] if len(blocks) else whole
    return [
        Figure("tick compute", spread(whole), "us", COMPUTE),
        Figure("  quietest block", spread(quietest), "us", note=f"of {len(blocks)} of {BLOCK} ticks"),
        Figure("  after a sleep", spread(slept), "us", note=f"of {SLEEP_S * 1e6:.0f} us"),
        *_laws(benchmark),
    ]


def _tracking(benchmark: Benchmark, sleep_s: float) -> Ints:
    """Measure the time of each step on the path, ns. Raises RunError if a step differs from the record."""
    cycle = benchmark.cycle()
    gc.collect()
    with collector_paused():
        found = list(steps(benchmark.ticks, cycle, sleep_s))
    if different := sum(not step.same for step in found):
        raise RunError(f"{different} ticks of the replay differ")
    return np.array([step.took_ns for step in found if step.mode is Mode.TRACKING], np.int64)


def _laws(benchmark: Benchmark) -> Iterator[Figure]:
    """Measure the time of forward kinematics alone and with each law, 0.1 mm off one period of the path."""
    c, parts = benchmark.configuration, benchmark.cycle().parts
    period_s = 1.0 / c.loop.rate_Hz
    context = LawContext(parts.platform, parts.model.leg_spin, period_s)
    path = []
    for k in range(PATH_TICKS):
        row = new_record()
        fill_reference(parts.platform, parts.trajectory.sample(k * period_s), row)
        row["tick"], row["t_d"], row["drive_state"] = k, k * period_s, DriveState.RUN
        row["q"], row["dq"] = row["q_d"] + OFF, row["dq_d"]
        path.append(row)
    designed = StateSpaceSettings(law="state_space", controller_file="mu")
    effects: dict[str, Callable[[Record], object]] = {"forward kinematics": lambda _: None}
    for name, settings in (chosen(c) | {"state_space": designed}).items():
        law = settings.build(context._replace(controller=controller_of(settings, c.folder)))
        effects[f"  with {name}"] = law.effort
    for name, effort in effects.items():
        estimator, times = Estimator(parts.platform, path[0]["p_d"], path[0]["R_d"]), []
        for row in map(copy_of, path):
            begun = _now()
            estimator.update(row)
            effort(row)
            times.append(_now() - begun)
        found = spread(times)
        yield Figure(name, {"median": found["median"]}, "us", COMPUTE, f"p99 {found['p99']:.3g}")
