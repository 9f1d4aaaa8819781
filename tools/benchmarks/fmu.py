"""One step of our FMU: in C alone, through the host in this process, and in a child process."""

import ctypes
import time

import numpy as np

from drivers.arrays import Array
from drivers.tick_columns import Record
from hil.app.compose import build_cycle, build_nodes
from plant_fmu.fmu.call import do_step
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.plant import Plant
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, Mark, spread

STEPS = 4000
STRETCH = 200
"""Steps between two resets: the legs are free, so they must not reach their end stops."""
STEP_S = 1e-3
_now = time.perf_counter_ns


def fmu(benchmark: Benchmark) -> list[Figure]:
    """Step the platform at its weight's force, brakes open, 1 ms at a time."""
    c = benchmark.configuration
    benchmark.say("the FMU, in process and in a child process")
    cycle = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)
    rest = np.zeros(6)
    weight = cycle.effort.model.inverse_dynamics(cycle.parts.home_p, cycle.parts.home_R, rest, rest)
    _, host = build_nodes(c)
    try:
        assert isinstance(host, FmuHost)
        alone, nothing = _alone(host, weight)
        hosted = _hosted(host, weight)
        child = ChildHost(host.spec)
    finally:
        host.close()
    try:
        apart = _hosted(child, weight)
    finally:
        child.close()
    call, whole = float(np.median(alone)), float(np.median(hosted))
    internal = f"{round(STEP_S / host.internal_step_s)} internal steps"
    return [
        Figure("1 ms step in C", spread(alone), "us", Mark(30.0), internal),
        Figure("hosted, in process", spread(hosted), "us"),
        Figure("  hosting, medians", {"": (whole - call) * 1e-3}, "us", Mark(6.0), "with inputs, outputs"),
        Figure("hosted, child process", spread(apart), "us"),
        Figure("  hosting, medians", {"": (float(np.median(apart)) - call) * 1e-3}, "us"),
        Figure("an empty C call", {"": nothing * 1e-3}, "us", note="subtracted from the step in C"),
    ]


def _hosted(plant: Plant, force: Array) -> list[int]:
    """Return the time of each `Plant.step`, ns."""
    brake, wrench = np.zeros(6), np.zeros(6)
    took = []
    for k in range(STEPS):
        if k % STRETCH == 0:
            plant.reset()
        begun = _now()
        plant.step(force, brake, wrench, STEP_S)
        took.append(_now() - begun)
    return took


def _alone(host: FmuHost, force: Array) -> tuple[Array, float]:
    """Return the times of DoStep of the host's instance, ns, less that of an empty call, and the latter."""
    brake, wrench = np.zeros(6), np.zeros(6)
    call = host._record  # noqa: SLF001 - the C call without the host around it
    ticks = round(STEP_S / host.internal_step_s)
    took = []
    for k in range(STEPS):
        if k % STRETCH == 0:
            host.reset()
            host.step(force, brake, wrench, STEP_S)
            tick = ticks
        t_s = tick * host.internal_step_s
        begun = _now()
        status = do_step(call, t_s, STEP_S)
        took.append(_now() - begun)
        assert status == 0
        tick += ticks
    host.reset()
    nothing = _empty_call(call)
    return np.array(took, float) - nothing, nothing


def _empty_call(call: Record) -> float:
    """Return what such a call into C costs by itself, ns: that of a function that does little."""
    little = call.copy()
    little["step"] = ctypes.cast(ctypes.CDLL(None).abs, ctypes.c_void_p).value or 0
    took = []
    for _ in range(STEPS):
        begun = _now()
        do_step(little, 0.0, STEP_S)
        took.append(_now() - begun)
    return float(np.median(took))
