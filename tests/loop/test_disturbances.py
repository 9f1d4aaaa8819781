"""Printed bounds against disturbances within the stated ones, on the bus path: none is exceeded, none is far
off.

For every law the stated disturbance is a force of at most `FORCE_N` at the platform's origin, in any
direction, at any time. The hardest one for a leg switches with the sign of its reversed impulse response,
along its row of J M^-1. For a loop that leaves its layer, the response along the run is used, found by
repetition. Others are square waves around the resonance, ramps, or random. They follow one another in one
run: the printed bound applies to all of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.stability.axes import bounded
from hil.app.stability.command import judge
from hil.app.stability.subject import Stated, Subject
from hil.control.law import ErrorDynamics
from hil.control.sliding_mode import SlidingModeSettings
from hil.design.stability.disturbance import Load
from hil.design.stability.sampled_loop import Sampled, disturbed_axis
from hil.mathematics.rotations import relative_rotation
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.faults.kinds import FramesDelay, WrenchStep
from tests.broad import broad
from tests.loop.bench import changed, succeeded

FORCE_N = 5000.0
BEGINS_s = 2.5
"""Time after power-up at which tracking has begun."""
COMMAND_ID = 0x110
"""Identifier in layout `fd`."""
COMMANDS_LATE_ms = 0.35
"""Delay of commands in a gateway: they then arrive just before the next SYNC, the worst allowed case."""
LOOKAHEAD = {"delay_compensation": {"bus_ms": 0.62, "drive_lag_ms": 0.796, "hold_ms": 0.5}}
LINEAR = {"inverse_dynamics", "pose_inverse_dynamics", "partial_linearisation"}
REDESIGN = {"law": "robust_inverse_dynamics", "wn_rad_s": 60}


class Case(NamedTuple):
    law: dict[str, Any]
    stated: bool = True
    """True if `hil stability` gets the force as an option; otherwise section uncertainty states it."""
    rest: bool = True


def gains(wn: Any, **more: Any) -> dict[str, Any]:
    return {"law": "inverse_dynamics", "wn_rad_s": wn, **more}


def sliding(rate: float) -> dict[str, Any]:
    return {"law": "sliding_mode", "lambda_rad_s": rate, "reaching_m_s2": 1}


CASES = {
    "sliding, lambda 240": Case(sliding(240), stated=False),
    "wn 20": Case(gains(20)),
    "wn 20 along the path": Case(gains(20), rest=False),
    "wn 220": Case(gains(220)),
    "lightly damped": Case(gains(60, damping_ratio=0.15)),
    "different legs": Case(gains([20, 30, 40, 60, 90, 120])),
    "looks ahead": Case(gains(90, **LOOKAHEAD)),
    "a tenth too light": Case(gains(40, model={"inertia_scale": 0.9})),
    "pose": Case({"law": "pose_inverse_dynamics", "wn_rad_s": 40}),
    "partial linearisation": Case({"law": "partial_linearisation", "wn_rad_s": 40}, rest=False),
    "sliding": Case(sliding(92), stated=False),
    "sliding, knows the force": Case(sliding(92)),
    "redesign": Case(REDESIGN | {"boundary_layer_m_s": 0.3}, stated=False),
    "redesign, thin layer": Case(REDESIGN | {"boundary_layer_m_s": 0.08}, stated=False),
}


@pytest.mark.parametrize(
    ("name", "count"), broad([("wn 20", 15), *((n, 30 if n == "lightly damped" else 100) for n in CASES)], 1)
)
def test_error_under_disturbances_of_the_configured_size_stays_within_the_printed_bound(name, count):
    case = CASES[name]
    mobility = _mobility()
    D = float(FORCE_N * np.linalg.norm(mobility[:, :3], axis=1).max())
    brief = configured(case, D, 10.0)
    pushes = list(forces(brief, mobility, count))
    c = configured(case, D, pushes[-1].at_s + 1.0)
    verdict = judge(c, Stated(Load(FORCE_N)) if case.stated else Stated())
    assert verdict.status == "conditional", verdict.claim
    bound = np.array(verdict.figures["ultimate_bound"])
    late = FramesDelay(at_s=0.0, by_ms=COMMANDS_LATE_ms, identifier=COMMAND_ID)
    rows = succeeded(c, late, *pushes).tracking
    if c.controller.axes == "pose":
        e = np.hstack([rows["p_d"] - rows["p"], [relative_rotation(r["R_d"], r["R"]) for r in rows]])
    else:
        e = rows["q_d"] - rows["q"]
    worst = np.abs(e).max(axis=0)
    ratio = (bound / worst).min()
    assert (worst <= bound).all()
    assert ratio <= 3.0


def forces(c: Configuration, mobility: Array, count: int) -> Iterator[WrenchStep]:
    """Yield `count` disturbances, one after the other, as force steps."""
    law = c.controller
    dynamics = law.error_dynamics()
    assert isinstance(dynamics, ErrorDynamics)
    pose = dynamics.pose
    judged = bounded(Subject(c, Stated()), law, "pose" if pose else "joint", dynamics.K_P, dynamics.K_D)
    rows = np.linalg.inv(Model(build_platform(c.platform)).mass_matrix(*pose_arrays(c.platform.home)))
    rows = (rows if pose else mobility)[: 3 if pose else 6, :3]
    ways = FORCE_N * rows / np.linalg.norm(rows, axis=1, keepdims=True)
    draw = np.random.default_rng(7)
    t = BEGINS_s
    for n in range(count):
        axis = n % len(ways)
        loop = judged.loops[axis]
        lasts = round(min(1.0, max(0.1, 8.0 / loop.decay_rate)), 3)
        way, ticks = ways[axis] * (-1) ** (n // len(ways)), round(lasts / 1e-3)
        kind = n // (2 * len(ways)) % 5
        if kind == 0:  # the hardest: the reversed impulse response
            pattern = hardest(c, loop, float(np.abs(mobility[axis, :3] @ way)), ticks)
        elif kind == 1:  # resonant
            assert loop.margins is not None
            at = loop.margins.crossover_rad_s * draw.uniform(0.3, 1.5)
            pattern = np.sign(np.sin(at * 1e-3 * (np.arange(ticks) + 0.5)))
        elif kind == 2:
            pattern = np.floor(np.linspace(-10.0, 10.99, ticks)) / 10.0
        else:  # drawn, in a direction of its own
            way = draw.normal(size=3)
            way *= FORCE_N / np.linalg.norm(way)
            pattern = np.repeat(draw.choice([-1.0, 1.0], ticks), draw.integers(1, 30))[:ticks]
        edges = np.flatnonzero(np.diff(pattern)) + 1
        for begin, end in zip([0, *edges], [*edges, ticks], strict=True):
            if pattern[begin]:
                at_s, for_s = t + begin * 1e-3, (end - begin) * 1e-3
                yield WrenchStep(at_s=at_s, for_s=for_s, force_N=tuple(pattern[begin] * way))
        t += lasts


def hardest(c: Configuration, loop: Sampled, d: float, ticks: int) -> Array:
    """Signs (ticks,) of an acceleration d, m/s^2, that maximise the loop's last |e|."""
    h = loop.responses(0)[1:, 0]
    pattern = np.sign(np.resize(np.append(h[:ticks], np.zeros(max(0, ticks - len(h)))), ticks)[::-1])
    law = c.controller
    if not isinstance(law, SlidingModeSettings):
        return pattern
    A, B, C, _, _ = disturbed_axis(Subject(c, Stated()).axis)
    dynamics = law.error_dynamics()
    slope, layer, k = float(np.max(dynamics.slope)), float(dynamics.layer), law.switching_gain
    draw, found, best = np.random.default_rng(3), pattern, 0.0
    for repeat in range(40):
        x, inside = np.zeros(len(A)), []
        for sign in pattern:
            e, de = -C @ x
            inside.append(abs(de + slope * e) < layer)
            u = slope * de + k * np.clip((de + slope * e) / layer, -1.0, 1.0)
            x = A @ x + B[:, 0] * u + B[:, 1] * sign * d
        if abs(C[0] @ x) > best:
            found, best = pattern.copy(), abs(C[0] @ x)
        weight, effect = C[0], np.empty(ticks)  # of d at each tick in the last position, along this run
        for n in reversed(range(ticks)):
            effect[n] = B[:, 1] @ weight
            in_layer = k / layer * inside[n]
            weight = (A - np.outer(B[:, 0], [slope * in_layer, slope + in_layer] @ C)).T @ weight
        wanted = np.sign(effect) * (np.sign(C[0] @ x) or 1.0)
        pattern = np.where(draw.random(ticks) < (0.5 if repeat % 3 else 1.0), wanted, pattern)
    return found


def configured(case: Case, D: float, lasts_s: float) -> Configuration:
    """`D`: the largest acceleration of a leg under the force."""
    uncertain = {} if case.law["law"] in LINEAR else {"uncertainty": {"disturbance_m_s2": D}}
    hold = {"type": "hold", "duration_s": lasts_s}
    return changed(
        "virtual",
        controller=case.law | uncertain,
        reference=hold if case.rest else {"periods": ceil(lasts_s / 2.0)},
        limits={"following_error_m": 0.1, "force_N": 1e5, "force_step_N": 2e5, "force_window_N": 2e5},
        drives={"force_limit_N": 1e5},
    )


def _mobility() -> Array:
    """J M^-1 at home (6, 6): accelerations of the legs per wrench."""
    c = load("virtual")
    platform = build_platform(c.platform)
    p, R = pose_arrays(c.platform.home)
    return np.asarray(jacobian(platform, p, R) @ np.linalg.inv(Model(platform).mass_matrix(p, R)), float)
