"""Time of one step of our FMU: in C alone, hosted in this process, and in a child process."""

import time
from collections.abc import Callable
from contextlib import closing

import numpy as np

from drivers.arrays import Array
from hil.app.compose import build_nodes
from plant_fmu.fmu.call import do_step
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.plant import Plant
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, Mark, spread

STEPS = 4000
STRETCH = 200
"""Number of steps between two resets: the legs move freely and must not reach their end stops."""
STEP_S = 1e-3
REST = np.zeros(6)
_now = time.perf_counter_ns


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
