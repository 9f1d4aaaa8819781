"""The mathematics of a tick under each control law: forward kinematics and the law; and what may be added."""

import time
from collections.abc import Callable

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS, DriveState
from drivers.tick_columns import Record, copy_of, new_record
from hil.app.compose import build_cycle, build_observer, build_predictor
from hil.config.delay import DelayCompensation
from hil.config.linear_controller import LinearController
from hil.config.wrench import WrenchSettings
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.law import LawContext
from hil.control.state_space import StateSpaceSettings
from hil.estimation.observer import observe as take_on
from hil.estimation.pose import Estimator
from hil.estimation.predictor import ahead
from hil.loop.parts import Parts
from hil.loop.reference import fill_reference
from hil.study.compare.laws import chosen
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, Mark, spread

TICK = Mark(40.0, of=("median",))
"""us, one tick of mathematics with any law."""
FULL_ORDER = Mark(20.0, of=("median",))
"""us, the same with a controller of mu synthesis that nobody has reduced."""
STATES = 24
"""More than D-K iteration ends with for the shipped design: 16."""
TICKS = 2000
"""One period of the path at 1 kHz."""
OFF = np.full(LEGS, 1e-4)
"""m: how far the legs are off the path."""
Work = Callable[[Record], object]
_now = time.perf_counter_ns


def laws(benchmark: Benchmark) -> list[Figure]:
    """Follow one period of the path with each law, then with a predictor and an observer beside none."""
    benchmark.say("each law along one period of the path")
    c = benchmark.configuration
    period = 1.0 / c.loop.rate_Hz
    parts = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts
    path = _along(parts, c.loop.rate_Hz)
    context = LawContext(parts.platform, parts.model.leg_spin, period, parts.trajectory)
    figures = []
    own = {name: settings for name, settings in chosen(c).items() if settings.law != "state_space"}
    for name, settings in own.items():
        figures.append(Figure(name, spread(_follow(parts, path, settings.build(context).effort)), "us", TICK))
    designed = StateSpaceSettings(law="state_space", controller_file="mu")
    law = designed.build(context._replace(controller=_full_order(c.loop.rate_Hz)))
    states = Figure(
        "state_space", spread(_follow(parts, path, law.effort)), "us", FULL_ORDER, f"{STATES} states"
    )
    figures.append(states)

    delay = DelayCompensation(bus_ms=0.5, drive_lag_ms=0.8, hold_ms=0.5)
    compensated = InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0, delay_compensation=delay)
    predictor = build_predictor(compensated, parts.platform, parts.model.leg_spin, period)
    observer = build_observer(
        WrenchSettings(source="observer", bus_ms=0.5, drive_lag_ms=0.8),
        parts.platform,
        parts.model.leg_spin,
        period,
    )
    assert predictor is not None
    assert observer is not None

    def look_ahead(tick: Record) -> None:
        ahead(predictor.record, 1, tick)
        predictor.path.send(tick["q_d"])

    def observe(tick: Record) -> None:
        take_on(observer.record, 1, tick)
        observer.path.send(tick["q_d"])

    for name, work in {
        "no law, delay compensation": look_ahead,
        "no law, momentum observer": observe,
    }.items():
        figures.append(Figure(name, spread(_follow(parts, path, work)), "us"))
    return figures


def _along(parts: Parts, rate_Hz: float) -> list[Record]:
    """Return the ticks of one period of the path: the reference, and the legs on it."""
    path = []
    for k in range(TICKS):
        tick = new_record()
        fill_reference(parts.platform, parts.trajectory.sample(k / rate_Hz), tick)
        tick["tick"], tick["t_d"] = k, k / rate_Hz
        tick["q"], tick["dq"] = tick["q_d"], tick["dq_d"]
        path.append(tick)
    return path


def _full_order(rate_Hz: float) -> LinearController:
    """Return a controller of STATES states, every number of which counts."""
    n = STATES
    return LinearController(
        kind="linear-controller",
        method="mu",
        axes="joint",
        rate_Hz=rate_Hz,
        inputs=["error", "rate_error"],
        A=[[0.9 / n] * n] * n,
        B=[[1.0, 0.1]] * n,
        C=[[1.0] * n],
        D=[[400.0, 40.0]],
        anti_windup=[0.0] * n,
        design={},
    )


def _follow(parts: Parts, path: list[Record], work: Work) -> Array:
    """Return the ns of each tick: the pose from lengths that are off the path, and `work`."""
    estimator = Estimator(parts.platform, path[0]["p_d"], path[0]["R_d"])
    times = np.zeros(len(path))
    for k, each in enumerate(path):
        tick = copy_of(each)
        tick["q"] += OFF
        tick["drive_state"] = DriveState.RUN
        begun = _now()
        estimator.update(tick)
        work(tick)
        times[k] = _now() - begun
    return times
