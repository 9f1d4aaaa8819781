"""Errors stay within the printed bounds while the printed premises on timing hold.

Within the premises are disturbances, commands that arrive late but before the next SYNC, and feedback that is
late or lost for fewer ticks than `limits.stale_warn_ticks`. Outside the premises a run warns before its error
exceeds the bound. Each law with a bound runs with the observer of the wrench and without it.

Each case draws 20 disturbances and 20 timings. `make claims` sets PREMISES=200: all cases with ten seeds.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from math import ceil
from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.signals import Warn
from hil.app.configuration.configuration import Configuration
from hil.app.stability.assessment import Assessment
from hil.app.stability.command import judge
from hil.app.stability.subject import Stated
from hil.design.stability.disturbance import Load
from hil.mathematics.rotations import relative_rotation
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import FramesDelay, FramesLoss, WrenchStep
from tests.broad import broad
from tests.loop.bench import changed, run, succeeded

COUNT = 20
SEEDS = range(11, 11 + max(1, int(os.environ.get("PREMISES", "20")) // COUNT))
FORCE_N = 2000.0
BEGINS_s = 2.5
"""Time after power-up at which tracking has begun."""
COMMAND = 0x110
FEEDBACK = range(0x281, 0x287)
"""Identifiers in layout `fd`."""
LAWS: dict[str, dict[str, Any]] = {
    "wn 20": {"law": "inverse_dynamics", "wn_rad_s": 20},
    "wn 60": {"law": "inverse_dynamics", "wn_rad_s": 60},
    "looks ahead": {
        "law": "inverse_dynamics", "wn_rad_s": 60,
        "delay_compensation": {"bus_ms": 0.62, "drive_lag_ms": 0.796, "hold_ms": 0.5},
    },
    "a tenth too light": {"law": "inverse_dynamics", "wn_rad_s": 40, "model": {"inertia_scale": 0.9}},
    "pose": {"law": "pose_inverse_dynamics", "wn_rad_s": 20},
    "partial linearisation": {"law": "partial_linearisation", "wn_rad_s": 40},
    "redesign": {
        "law": "robust_inverse_dynamics", "wn_rad_s": 60, "boundary_layer_m_s": 0.3,
        "uncertainty": {"disturbance_m_s2": 4},
    },
    "sliding": {
        "law": "sliding_mode", "lambda_rad_s": 40, "reaching_m_s2": 4, "uncertainty": {"disturbance_m_s2": 4},
    },
    "hinf": {"law": "state_space", "controller_file": "hinf"},
    "mu": {"law": "state_space", "controller_file": "mu"},
}  # fmt: skip
OBSERVER = {"source": "observer", "bandwidth_Hz": 15}


def configured(law: dict[str, Any], *, observes: bool, warn: int = 1, lasts_s: float) -> Configuration:
    return changed(
        "virtual",
        controller=law,
        estimation={"wrench": OBSERVER} if observes else {},
        reference={"periods": ceil(lasts_s / 2.0)},
        limits={
            "stale_warn_ticks": warn, "following_error_m": 0.1, "force_N": 1e5, "force_step_N": 2e5,
            "force_window_N": 2e5,
        },
        drives={"force_limit_N": 1e5},
    )  # fmt: skip


def bound_of(verdict: Assessment) -> Array:
    assert verdict.status == "conditional", verdict.claim
    return np.array(verdict.figures["ultimate_bound"])


def errors(c: Configuration, rows: Any) -> Array:
    """Errors (n, 6) of the law's axes, m and rad."""
    if c.controller.axes == "pose":
        turned = [relative_rotation(r["R_d"], r["R"]) for r in rows]
        return np.hstack([rows["p_d"] - rows["p"], turned])
    return np.asarray(rows["q_d"] - rows["q"])


def disturbances(draw: np.random.Generator, count: int) -> Iterator[WrenchStep]:
    """Yield forces in random directions, one after the other, for 0.05 to 0.5 s each."""
    t = BEGINS_s
    for _ in range(count):
        way, lasts = draw.normal(size=3), round(float(draw.uniform(0.05, 0.5)), 3)
        way *= FORCE_N / np.linalg.norm(way)
        yield WrenchStep(at_s=t, for_s=lasts, force_N=tuple(way))
        t += lasts


def late_commands(draw: np.random.Generator, count: int) -> Iterator[FramesDelay]:
    """Yield command delays of up to 0.35 ms, one after the other; commands still precede the next SYNC."""
    for n in range(count):
        by_ms, probability = float(draw.uniform(0.0, 0.35)), float(draw.uniform(0.1, 1.0))
        at_s, for_s = BEGINS_s + 0.25 * n, 0.25
        yield FramesDelay(at_s=at_s, for_s=for_s, by_ms=by_ms, probability=probability, identifier=COMMAND)


CASES = [(name, observes) for name in LAWS for observes in (False, True)]
COUNTED = [
    (name, observes)
    for name, observes in CASES
    if "uncertainty" not in LAWS[name] and not (observes and name in {"pose", "hinf"})
]
"""Laws with a bound that includes feedback one tick old; those left out have none."""


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "observes"), CASES)
def test_error_stays_within_the_printed_bound_for_all_timing_within_its_limits(name, observes, seed):
    """As many disturbances as timings of the commands, one after the other."""
    draw = np.random.default_rng(seed)
    pushes = list(disturbances(draw, COUNT))
    lasts_s = pushes[-1].at_s + 1.0
    c = configured(LAWS[name], observes=observes, lasts_s=lasts_s)
    stated = Stated() if "uncertainty" in LAWS[name] else Stated(Load(FORCE_N))
    bound = bound_of(judge(c, stated))
    rows = succeeded(c, *pushes, *late_commands(draw, COUNT)).tracking
    worst = np.abs(errors(c, rows)).max(axis=0)
    assert not (rows["warnings"] & Warn.STALE).any()
    assert (worst <= bound).all(), (worst / bound).max()


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "observes"), COUNTED)
@pytest.mark.parametrize("lost", [False, True])
def test_error_with_feedback_one_period_old_stays_within_its_bound(name, observes, lost, seed):
    """With limits.stale_warn_ticks 2 the feedback of each leg may be one tick old."""
    draw = np.random.default_rng(seed)
    c = configured(LAWS[name], observes=observes, warn=2, lasts_s=BEGINS_s + 0.25 * COUNT + 0.5)
    bound = bound_of(judge(c))
    faults: list[Fault] = []
    for n in range(COUNT):
        legs = draw.choice(list(FEEDBACK), size=int(draw.integers(1, 7)), replace=False)
        begins = BEGINS_s + 0.25 * n
        for leg in map(int, legs):
            if lost:  # one frame at a time: two in a row would be older
                faults += [
                    FramesLoss(at_s=begins + 1e-3 * k, for_s=1e-3, identifier=leg)
                    for k in range(0, 250, int(draw.integers(20, 60)))
                ]
            else:
                faults.append(FramesDelay(at_s=begins, for_s=0.249, by_ms=0.5, identifier=leg))
    rows = succeeded(c, *faults).tracking
    assert (rows["age"].max(axis=1) == 1).sum() > 100
    assert not (rows["warnings"] & Warn.STALE).any()
    worst = np.abs(errors(c, rows)).max(axis=0)
    assert (worst <= bound).all(), (worst / bound).max()


EPISODE_s, APART_s = 0.15, 0.5


def untimely_feedback(draw: np.random.Generator, count: int) -> Iterator[Fault]:
    """Yield feedback of some legs that is late, jitters or is lost, with rests between; the last ends the run."""
    for n in range(count - 1):
        at_s, kind = BEGINS_s + APART_s * n, draw.integers(3)
        for leg in map(int, draw.choice(list(FEEDBACK), size=int(draw.integers(1, 7)), replace=False)):
            if kind == 0:  # below limits.stale_fault_ticks
                yield FramesLoss(at_s=at_s, for_s=1e-3 * float(draw.integers(1, 4)), identifier=leg)
            else:
                chance = float(draw.uniform(0.3, 1.0)) if kind == 1 else 1.0
                by_ms = float(draw.uniform(0.3, 0.9))
                yield FramesDelay(at_s=at_s, by_ms=by_ms, for_s=EPISODE_s, probability=chance, identifier=leg)
    yield FramesDelay(at_s=BEGINS_s + APART_s * (count - 1), by_ms=2.0, for_s=EPISODE_s)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("name", "observes"), broad(CASES, 1))
def test_late_feedback_causes_a_warning_before_the_tracking_error_exceeds_the_bound(name, observes, seed):
    c = configured(LAWS[name], observes=observes, lasts_s=BEGINS_s + APART_s * COUNT)
    bound = bound_of(judge(c))
    ran = run(c, *untimely_feedback(np.random.default_rng(seed), COUNT))
    rows = ran.tracking
    exceeds = np.asarray((np.abs(errors(c, rows)) > bound).any(axis=1))
    warned = (rows["warnings"] & Warn.STALE) > 0
    assert warned.sum() > COUNT
    for n in range(COUNT):
        episode = slice(*np.searchsorted(rows["tick"], 1e3 * (BEGINS_s + APART_s * (n + np.arange(2)))))
        for first in np.flatnonzero(exceeds[episode])[:1]:
            assert warned[episode][: first + 1].any(), n
    if certificate := ran.summary.get("certificate"):
        assert "late" in certificate["without_its_premise"]
