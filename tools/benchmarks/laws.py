"""The mathematics of a tick under each control law: forward kinematics and the law; and what may be added."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS, DriveState
from hil.app.compare.laws import chosen
from hil.app.compose import build_cycle, build_observer, build_predictor
from hil.config import DelayCompensation, InverseDynamicsSettings, StateSpaceSettings, WrenchSettings
from hil.config.linear_controller import LinearController
from hil.control import Law, LawContext, build_law
from hil.estimation.pose import Estimator
from hil.loop.parts import Parts
from hil.loop.reference import complete
from hil.signals import Reference, State
from tools.benchmarks.bench import Bench
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
_NONE = np.zeros(LEGS)
_RUN = [int(DriveState.RUN)] * LEGS
Work = Callable[[int, State, Reference], object]
_now = time.perf_counter_ns


def laws(bench: Bench) -> list[Figure]:
    """Follow one period of the path with each law, then with a predictor and an observer beside none."""
    bench.say("each law along one period of the path")
    c = bench.configuration
    period = 1.0 / c.loop.rate_Hz
    parts = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts
    path = [complete(parts.platform, parts.trajectory.sample(k * period), k * period) for k in range(TICKS)]
    context = LawContext(parts.platform, parts.leg_spin, period, parts.trajectory)
    figures = []
    own = {name: settings for name, settings in chosen(c).items() if settings.law != "state_space"}
    for name, settings in own.items():
        figures.append(
            Figure(name, spread(_follow(parts, path, _effort(build_law(settings, context)))), "us", TICK)
        )
    designed = StateSpaceSettings(law="state_space", controller_file="mu")
    law = build_law(designed, context._replace(controller=_full_order(c.loop.rate_Hz)))
    states = Figure(
        "state_space", spread(_follow(parts, path, _effort(law))), "us", FULL_ORDER, f"{STATES} states"
    )
    figures.append(states)

    delay = DelayCompensation(bus_ms=0.5, drive_lag_ms=0.8, hold_ms=0.5)
    compensated = InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0, delay_compensation=delay)
    predictor = build_predictor(compensated, parts.platform, parts.leg_spin, period)
    observer = build_observer(
        WrenchSettings(source="observer", bus_ms=0.5, drive_lag_ms=0.8),
        parts.platform,
        parts.leg_spin,
        period,
    )
    assert predictor is not None
    assert observer is not None

    def look_ahead(k: int, state: State, r: Reference) -> None:
        predictor.ahead(k, state, free=True)
        predictor.sent(r.q)

    def observe(k: int, state: State, r: Reference) -> None:
        observer.observe(k, state, _RUN)
        observer.sent(r.q)

    for name, work in {
        "no law, delay compensation": look_ahead,
        "no law, momentum observer": observe,
    }.items():
        figures.append(Figure(name, spread(_follow(parts, path, work)), "us"))
    return figures


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


def _effort(law: Law) -> Work:
    return lambda _, state, reference: law.effort(state, reference, _NONE)


def _follow(parts: Parts, path: list[Reference], work: Work) -> Array:
    """Return the ns of each tick: the pose from lengths that are off the path, and `work`."""
    estimator = Estimator(parts.platform, path[0].p, path[0].R)
    times = np.zeros(len(path))
    for k, r in enumerate(path):
        q = r.q + OFF
        begun = _now()
        p, R, twist, J, iterations, residual, _, _ = estimator.update(q, r.dq)
        work(k, State(q, r.dq, p, R, twist, J, iterations, residual), r)
        times[k] = _now() - begun
    return times
