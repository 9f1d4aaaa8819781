"""What one tick computes, with everything in the caches."""

import gc

from hil.app.compose import build_cycle
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.parts import Parts
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, spread
from tools.benchmarks.timed_cycle import TimedCycle, compute_figure, feed, quietest_figure

SLEEP_S = 1e-5
"""As short as a sleep can be: it is not its length that counts."""


def tick(benchmark: Benchmark) -> list[Figure]:
    """Feed the recorded ticks of the simulated run from memory to a cycle, one after the other."""
    benchmark.say(f"{len(benchmark.held.entries)} ticks from memory, twice through the cycle")
    whole, slept = TimedCycle(_parts(benchmark)), TimedCycle(_parts(benchmark), SLEEP_S)
    different = max(_feed(benchmark, cycle) for cycle in (whole, slept))
    ns = whole.compute_ns()
    figures = [
        compute_figure(ns),
        quietest_figure(ns),
        Figure("  after a sleep", spread(slept.compute_ns()), "us", note=f"of {SLEEP_S * 1e6:.0f} us"),
    ]
    return (
        [*figures, Figure("result", note=f"{different} ticks came out differently")] if different else figures
    )


def _parts(benchmark: Benchmark) -> Parts:
    c = benchmark.configuration
    return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts


def _feed(benchmark: Benchmark, cycle: Cycle) -> int:
    """Return how many of the ticks came out differently."""
    gc.collect()
    with collector_paused():
        return feed(benchmark.held.entries, cycle)
