"""What the fused pose says of its own errors, in the loop.

With e the error of pose and twist and P its covariance, e^T P^-1 e / 12 has the mean 1 where P is right (NEES;
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.signals import LEGS, Fault, Mode
from hil.app.leg_errors import leg_errors
from hil.app.sim.lockstep import Lockstep
from plant_fmu.faults.kinds import EncoderLost
from tests.broad import broad
from tests.loop.fused import ANY_LEG, UNPROVEN, Tracked, seen, track

SHORT: dict[str, dict[str, Any]] = {"virtual": {"periods": 1}, "lab": {"duration_s": 6}}
RMS_MM = {"virtual": 0.36e-3, "lab": 0.12e-3}
"""On `virtual` that of the legs alone, whose encoders have steps of 1 um; on `lab` the steps are 0.15 um."""


def bench(name: str, fusion: dict[str, Any] | None = None, **sections: Any) -> Any:
    estimation = {"pose": "fused", "fusion": fusion or {}}
    return seen(name, estimation=estimation, **{"reference": SHORT[name]} | sections)


def covariance(lockstep: Lockstep) -> Array:
    estimator: Any = lockstep.cycle.parts.fusion
    return np.asarray(estimator._covariances[estimator.record["newest"]][:12, :12].copy())


def used(found: Tracked) -> Any:
    """Return (n, 6) which legs were used."""
    return found.rows["legs_used"][:, None] >> np.arange(LEGS) & 1


def assert_consistent(found: Tracked, rms_mm: float) -> None:
    """Overconfident is what no leg and no limit survives: not over 1.5 even for pose and twist alone."""
    assert found.end == (Mode.PARKED, Fault.NONE)
    assert 0.5 < found.nees().mean() < 1.5
    assert np.quantile(found.nees(), 0.99) < 3
    assert 0.5 < found.nees(last=6).mean() < 1.5
    assert found.nees(first=6).mean() < 1.5
    assert np.mean(used(found) == 0) < 1e-3
    assert found.rms_mm < rms_mm


RUNS: list[tuple[str, int, dict[str, Any] | None, dict[str, Any]]] = [
    *((name, seed, None, {}) for seed in range(1, 4) for name in ("virtual", "lab")),
    ("lab", 1, None, {"reference": {}}),  # the whole ride
    *(  # friction that is stated three times too large or five times too small
        ("lab", 1, {"leg_force_std_N": 60}, {"plant": {"model": {"coulomb_friction_N": friction_N}}})
        for friction_N in (300, 20)
    ),
]


@pytest.mark.parametrize(("name", "seed", "fusion", "sections"), broad(RUNS, quick=1))
def test_its_errors_are_as_large_as_it_says_and_no_good_leg_is_left_out(name, seed, fusion, sections):
    found = track(bench(name, fusion, **sections), seed=seed, covariance=covariance)
    assert_consistent(found, RMS_MM[name])


@pytest.mark.long
def test_where_the_force_is_denied_good_legs_are_left_out_and_the_filter_is_too_sure():
    """What the states of the leg forces are for: without them the model is taken at its word."""
    found = track(bench("lab", {"leg_force_std_N": 0}), covariance=covariance)
    assert found.nees().mean() > 3
    assert np.mean(used(found) == 0) > 0.01


@pytest.mark.long
@pytest.mark.parametrize("leg", [4, 1])
def test_with_friction_a_lost_encoder_is_survived_and_the_filter_knows_how_unsure_it_is(leg):
    """Where no leg sees, only the tracker of 1 mm stands against friction: the lengths bend within that."""
    found = track(bench("lab", ANY_LEG), EncoderLost(leg=leg, at_s=3.0), covariance=covariance)
    assert found.end == UNPROVEN
    assert found.rms_mm < 0.4
    assert found.position_mm.max() < 2
    lost = used(found)[:, leg] == 0
    assert lost.sum() > 4000
    assert np.median(found.nees()[lost]) < 1
    assert found.nees()[lost].mean() < 6
    off, said = np.sum(found.e[:, :3] ** 2, axis=1), np.trace(found.P[:, :3, :3], axis1=1, axis2=2)
    assert 0.5 < np.mean((off / said)[lost]) < 2.5


def test_noise_and_force_follow_from_encoders_friction_and_the_monitor():
    found = leg_errors(bench("lab"))
    steps = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 200_000)) * [[1.5e-7], [1e-7]]
    assert found.length_std_m == pytest.approx(steps.sum(axis=0).std(), rel=0.01)
    assert found.force_std_N == 60.0, "the plant's"
    assert found.rate_skew_std_s == pytest.approx(50e-6 / np.sqrt(3))
    assert found.rate_scale_std == pytest.approx(0.01 / np.sqrt(3))
    assert leg_errors(bench("virtual")).force_std_N == 0.0
    plantless = leg_errors(bench("lab").model_copy(update={"plant": None}))
    assert plantless.force_std_N == pytest.approx(0.05 * 2000), "5 % of the smallest force limit"
    assert plantless.length_std_m == pytest.approx(2e-6 / np.sqrt(12))
