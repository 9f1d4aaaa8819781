"""Errors stay within the printed bounds while the printed premises on timing hold.

Within the premises are disturbances, commands that arrive late but before the next SYNC, and feedback that is
late or lost for fewer ticks than `limits.stale_warn_ticks`. Outside the premises a run warns before its error
exceeds the bound. Each law runs with the observer of the wrench and without it.
"""

from __future__ import annotations

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
    assert verdict.status == "conditional", verdict.line
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


@pytest.mark.long
@pytest.mark.parametrize(("name", "observes"), CASES)
def test_no_timing_within_the_premises_exceeds_the_printed_bound(name, observes):
    """20 disturbances and 20 timings of the commands of each law."""
    draw = np.random.default_rng(11)
    pushes = list(disturbances(draw, 20))
    lasts_s = pushes[-1].at_s + 1.0
    c = configured(LAWS[name], observes=observes, lasts_s=lasts_s)
    stated = Stated() if "uncertainty" in LAWS[name] else Stated(Load(FORCE_N))
    bound = bound_of(judge(c, stated))
    rows = succeeded(c, *pushes, *late_commands(draw, 20)).tracking
    worst = np.abs(errors(c, rows)).max(axis=0)
    assert not (rows["warnings"] & Warn.STALE).any()
    assert (worst <= bound).all(), (worst / bound).max()


@pytest.mark.long
@pytest.mark.parametrize(("name", "observes"), CASES[:4])
@pytest.mark.parametrize("lost", [False, True])
def test_old_feedback_of_the_stated_age_stays_within_its_bound(name, observes, lost):
    """With limits.stale_warn_ticks 2 the feedback of each leg may be one tick old."""
    draw = np.random.default_rng(5)
    c = configured(LAWS[name], observes=observes, warn=2, lasts_s=8.0)
    bound = bound_of(judge(c))
    faults: list[Fault] = []
    for n in range(20):
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


@pytest.mark.parametrize(("name", "observes"), broad(CASES, 1))
@pytest.mark.parametrize("by_ms", broad([0.1, 2.0], 1))
def test_late_feedback_warns_before_the_error_exceeds_the_bound(name, observes, by_ms):
    c = configured(LAWS[name], observes=observes, lasts_s=2.0)
    bound = bound_of(judge(c))
    ran = run(c, FramesDelay(at_s=2.0, by_ms=by_ms, for_s=1.0))
    rows = ran.tracking
    exceeds = (np.abs(errors(c, rows)) > bound).any(axis=1)
    warned = (rows["warnings"] & Warn.STALE) > 0
    assert warned.any()
    assert not exceeds.any() or np.argmax(warned) <= np.argmax(exceeds)
    assert "late" in ran.summary["certificate"]["without_its_premise"]
