"""What one tick computes, stage by stage, with everything in the caches."""

from __future__ import annotations

import gc

from hil.app.benchmarks.bench import Bench
from hil.app.benchmarks.figures import Figure
from hil.app.benchmarks.stages import StagedCycle, quietest_figure, stage_figures
from hil.app.compose import build_cycle
from hil.replay import replay


def tick(bench: Bench) -> list[Figure]:
    """Feed the recorded ticks of the simulated run from memory to a cycle, one after the other."""
    held = bench.held
    c = bench.configuration
    cycle = StagedCycle(build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts)
    bench.say(f"{len(held.entries)} ticks from memory through the cycle")
    gc.collect()
    gc.disable()  # as the daemon does
    try:
        verdict = replay(held, cycle)
    finally:
        gc.enable()
    different = "" if verdict.exact else f"{verdict.different_ticks} ticks came out differently"
    figures = [*stage_figures(cycle), quietest_figure(cycle)]
    return [*figures, Figure("result", note=different)] if different else figures
