"""Learning on plants within the stated uncertainty, and on plants beyond it."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hil.lab.learn.convergence import Uncertainty, choose, contraction, stated
from hil.lab.learn.judgement import contradiction, in_band, state
from hil.lab.learn.trial import FIRST_STEP, Trial, trial, updated
from tests.broad import broad
from tests.hil.lab.learn.plants import K_P, LEAD, Plant, T, nominal, run

STATED = stated(0.25, 1e-3, 100.0)
WN = np.full(6, K_P**0.5)


def of(plant: Plant, a: Any, believed: float, seed: int = 0) -> Trial | None:
    measured = run(plant, a, believed, seed)
    return None if measured is None else trial(T, LEAD, *measured, a, WN)


def learn(plant: Plant, runs: int, believed: float = 0.9, uncertainty: Uncertainty = STATED) -> Any:
    """Errors, mm, of consecutive runs, and the state or fault that ended them."""
    a = np.zeros((LEAD + 1000, 6))
    before = model = None
    errors: list[float] = []
    for number in range(runs):
        now = of(plant, a, believed, number)
        if now is None:
            return errors, "fault"
        if model is None:
            loops, f = nominal(now.e)
            c = contraction(loops, f, uncertainty)
            model = loops, f, c, choose(c, f).Q
        loops, f, c, Q = model
        inside = float(np.sqrt((in_band(now, Q, f) ** 2).mean()))
        errors.append(1e3 * now.rms_m)
        found = factor = None
        if before is not None:
            was, inside_before = before
            factor = inside / inside_before
            first = 1e-3 * errors[0]
            found = contradiction(was, now, loops, c, Q, f, first_rms_m=first, noise_m=1e-7)
        goes = state(found is not None, inside, factor, 1e-7)
        if goes != "learned":
            return errors, goes
        a, before = updated(now, loops, Q, f, 1.0 if before else FIRST_STEP), (now, inside)
    return errors, "learned"


def contradicted_by(plant: Plant) -> Any:
    """Contradiction in the second run of a plant."""
    first = of(plant, np.zeros((LEAD + 1000, 6)), 0.9)
    assert first is not None
    loops, f = nominal(first.e)
    c = contraction(loops, f, STATED)
    Q = choose(c, f).Q
    second = of(plant, updated(first, loops, Q, f, FIRST_STEP), 0.9)
    assert second is not None
    return contradiction(first, second, loops, c, Q, f, first_rms_m=first.rms_m, noise_m=1e-7)


def mixed(size: float) -> Any:
    """Matrix (6, 6) that couples the legs: identity plus a Delta of norm `size`."""
    other = np.random.default_rng(3).standard_normal((6, 6))
    return np.eye(6) + size * other / np.linalg.norm(other, 2)


WITHIN = {
    "gain 0.8": Plant(gain=0.8),
    "gain 1.2": Plant(gain=1.2),
    "half the delay more": Plant(lag_s=1.3e-3),
    "coupled legs": Plant(coupling=mixed(0.2)),
    "a gain for each leg": Plant(gain=np.array([0.8, 1.2, 0.9, 1.1, 1.0, 0.85])),
    "friction": Plant(friction=0.3),
    "a spring": Plant(stiffness=20.0),
}


@pytest.mark.parametrize("name", broad(WITHIN, quick=1))
def test_learning_reduces_the_error_in_every_run_on_plants_within_the_stated_uncertainty(name: str) -> None:
    errors, end = learn(WITHIN[name], 6)
    assert end in {"learned", "floor"}
    assert errors[1] < 0.75 * errors[0]
    assert min(errors) < errors[0] / 20.0
    floor = 1.05 * min(errors)
    assert all(after < max(before, floor) for before, after in pairwise(errors))


BEYOND = {
    "learned forces of the wrong sign": Plant(learned=-np.eye(6)),
    "learned forces of the wrong legs": Plant(learned=np.roll(np.eye(6), 1, axis=0)),
    "one learned force of the wrong sign": Plant(learned=np.diag([1.0, 1.0, 1.0, -1.0, 1.0, 1.0])),
    "learned forces three times": Plant(learned=3.0 * np.eye(6)),
    "force of the wrong sign": Plant(gain=-1.0),
    "one leg of the wrong sign": Plant(gain=np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])),
    "gain 0.6": Plant(gain=0.6),
    "gain 2.2": Plant(gain=2.2),
    "gain 3": Plant(gain=3.0),
    "delay 6 ms": Plant(delay=6),
    "delay 10 ms": Plant(delay=10),
    "delay 15 ms": Plant(delay=15),
    "slow drives": Plant(lag_s=12e-3),
    "legs bend at 25 Hz": Plant(resonance_Hz=25.0, share=0.3),
    "legs bend at 35 Hz": Plant(resonance_Hz=35.0, damping=0.01, share=0.5),
    "legs bend at 50 Hz": Plant(resonance_Hz=50.0, damping=0.03, share=0.5),
    "force loop rings at 40 Hz": Plant(resonance_Hz=40.0, damping=0.05),
    "coupled legs": Plant(coupling=mixed(1.4)),
    "friction that holds": Plant(friction=1.5, gain=0.6),
    "a heavy payload on a spring": Plant(gain=0.65, stiffness=10.0),
}


@pytest.mark.parametrize("name", broad(BEYOND, quick=1))
def test_learning_on_plants_beyond_the_stated_uncertainty_ends_before_the_error_grows(name: str) -> None:
    errors, end = learn(BEYOND[name], 10)
    assert max(errors, default=0.0) <= 1.55 * (errors[0] if errors else 0.0), "the first update is halved"
    falls = [after < before for before, after in pairwise(errors)]
    assert all(falls[:-1]), "learning must end after a run with a larger error"
    if end in {"learned", "floor"}:
        assert min(errors) < errors[0] / 20.0
    else:
        assert len(errors) <= 3


def test_learning_with_a_wrong_force_sign_ends_and_reports_the_leg() -> None:
    found = contradicted_by(BEYOND["one learned force of the wrong sign"])
    assert found.axis == 3
    assert found.factor == pytest.approx(1.5, abs=0.1), "e_1 = e_0 + P_0 L e_0 / 2"
    assert found.allowed < 1.0
