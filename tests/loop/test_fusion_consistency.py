"""What the fused pose says of its own errors, in the loop: legs, model, and a tracker of 1 mm and 0.1 deg, 200 Hz,
5 ms late, 5 % lost.

With e the error of pose and twist and P its covariance, e^T P^-1 e / 12 has the mean 1 where P is right (NEES;
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 5.4). The truth is
the plant's, at the instant at which the drives latch.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import LEGS, Mode
from hil.app.configuration.configuration import load, loads
from hil.app.leg_errors import leg_errors
from plant_fmu.faults.kinds import EncoderLost
from tests.broad import broad
from tests.loop.test_fusion import ANY_LEG, FUSED, TRACKER, UNPROVEN
from tests.loop.tracked import track

SHORT = {"virtual": ("periods: 10", "periods: 1"), "lab": ("duration_s: 20", "duration_s: 6")}
NOISE = "{position_noise_m: 1e-3, orientation_noise_deg: 0.1, latency_ms: 5, lost_percent: 5}"


class Run(NamedTuple):
    """One run in lockstep, while tracking, without a log."""

    ending: tuple[Mode, int]
    e: np.ndarray
    """(n, 12) truth less estimate: m, rad, m/s, rad/s, base frame."""
    P: np.ndarray
    """(n, 12, 12) the filter's covariance of it."""
    used: np.ndarray
    """(n, 6) which legs were used."""

    def nees(self, first=0, last=12):
        """Return e^T P^-1 e of some of the twelve numbers, divided by how many they are, (n,)."""
        e, P = self.e[:, first:last], self.P[:, first:last, first:last]
        return np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0]) / (last - first)

    @property
    def position_rms(self):
        """Return the root of the mean squared error of the position, m."""
        return float(np.sqrt(np.mean(np.sum(self.e[:, :3] ** 2, axis=1))))


def fused(name, *, fusion="", changes=()):
    text = load(name).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    added = f"sensors:\n{TRACKER}{FUSED}{fusion}"
    text = text.replace("\nloop:\n", f"\n{added}\nloop:\n")
    return loads(f"{text}  sensors:\n    tracker: {NOISE}\n", f"{name}.yaml", Path())


def run(c, *faults, seed=1):
    covariances = []

    def seen(cycle, _row):
        if cycle.mode is Mode.TRACKING:
            estimator = cycle.parts.fusion
            covariances.append(estimator._covariances[estimator.record["newest"]][:12, :12].copy())

    ending, cycle, rows, truths = track(c, *faults, seed=seed, seen=seen)
    used = rows["legs_used"][:, None] >> np.arange(LEGS) & 1
    return Run((ending.mode, cycle.faults), errors(rows, truths), np.array(covariances), used)


def errors(rows, truths):
    """Return truths at the instants asked for less rows; the plant's next grid point is 25 us later."""
    at = np.array([snapshot.t_ns for _, snapshot in truths]) * 1e-9
    dt = np.array([[(t_ns - snapshot.t_ns) * 1e-9] for t_ns, snapshot in truths])
    p, R, twist = (
        np.array([getattr(snapshot.truth, name) for _, snapshot in truths]) for name in ("p", "R", "twist")
    )
    dtwist = np.diff(twist, axis=0, prepend=twist[:1]) / np.diff(at, prepend=at[0] - 1e-3)[:, None]
    there = Rotation.from_rotvec(twist[:, 3:] * dt) * Rotation.from_matrix(R)
    turned = there * Rotation.from_matrix(rows["R"].reshape(-1, 3, 3)).inv()
    return np.hstack(
        (p + twist[:, :3] * dt - rows["p"], turned.as_rotvec(), twist + dtwist * dt - rows["twist"])
    )


def assert_consistent(found, *, rms_m):
    """Overconfident is what no leg and no limit survives: not over 1.5 even for pose and twist alone."""
    assert found.ending == (Mode.PARKED, 0)
    assert 0.5 < found.nees().mean() < 1.5
    assert np.quantile(found.nees(), 0.99) < 3
    assert 0.5 < found.nees(last=6).mean() < 1.5
    assert found.nees(first=6).mean() < 1.5
    assert np.mean(found.used == 0) < 1e-3
    assert found.position_rms < rms_m


SEEDED = [(name, seed) for seed in range(1, 6) for name in ("virtual", "lab")]
RMS_M = {"virtual": 0.36e-6, "lab": 0.12e-6}
"""On `virtual` that of the legs alone, whose encoders have steps of 1 um; on `lab` the steps are 0.15 um."""


@pytest.mark.parametrize(("name", "seed"), broad(SEEDED, quick=1))
def test_its_errors_are_as_large_as_it_says_and_no_good_leg_is_left_out(name, seed):
    found = run(fused(name, changes=[SHORT[name]]), seed=seed)
    assert_consistent(found, rms_m=RMS_M[name])


@pytest.mark.long
def test_so_it_is_over_the_whole_ride_of_the_laboratory_hexapod():
    assert_consistent(run(fused("lab")), rms_m=RMS_M["lab"])


@pytest.mark.long
@pytest.mark.parametrize("friction_N", broad([300, 20], quick=1))
def test_friction_that_is_stated_three_times_too_large_or_five_times_too_small_does_no_harm(friction_N):
    changes = [SHORT["lab"], ("coulomb_friction_N: 60 ", f"coulomb_friction_N: {friction_N} ")]
    found = run(fused("lab", fusion="  fusion: {leg_force_std_N: 60}\n", changes=changes))
    assert_consistent(found, rms_m=RMS_M["lab"])


@pytest.mark.long
def test_where_the_force_is_denied_good_legs_are_left_out_and_the_filter_is_too_sure():
    """What the states of the leg forces are for: without them the model is taken at its word."""
    found = run(fused("lab", fusion="  fusion: {leg_force_std_N: 0}\n", changes=[SHORT["lab"]]))
    assert found.nees().mean() > 3
    assert np.mean(found.used == 0) > 0.01


@pytest.mark.long
@pytest.mark.parametrize("leg", [4, 1])
def test_with_friction_a_lost_encoder_is_survived_and_the_filter_knows_how_unsure_it_is(leg):
    """Where no leg sees, only the tracker of 1 mm stands against friction: the lengths bend within that."""
    found = run(fused("lab", fusion=ANY_LEG, changes=[SHORT["lab"]]), EncoderLost(leg=leg, at_s=3.0))
    assert found.ending == UNPROVEN
    assert found.position_rms < 0.4e-3
    assert np.linalg.norm(found.e[:, :3], axis=1).max() < 2e-3
    lost = found.used[:, leg] == 0
    assert lost.sum() > 4000
    assert np.median(found.nees()[lost]) < 1
    assert found.nees()[lost].mean() < 6
    off, said = np.sum(found.e[:, :3] ** 2, axis=1), np.trace(found.P[:, :3, :3], axis1=1, axis2=2)
    assert 0.5 < np.mean((off / said)[lost]) < 2.5


# -- what follows from what is stated ------------------------------------------------------------------------------


def test_noise_and_force_follow_from_encoders_friction_and_the_monitor():
    found = leg_errors(fused("lab"))
    steps = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 200_000)) * [[1.5e-7], [1e-7]]
    assert found.length_std_m == pytest.approx(steps.sum(axis=0).std(), rel=0.01)
    assert found.force_std_N == 60.0, "the plant's"
    assert found.rate_skew_std_s == pytest.approx(50e-6 / np.sqrt(3))
    assert found.rate_scale_std == pytest.approx(0.01 / np.sqrt(3))
    assert leg_errors(fused("virtual")).force_std_N == 0.0


def test_without_a_plant_five_percent_of_the_smallest_force_limit_count_as_friction():
    c = fused("lab").model_copy(update={"plant": None})
    found = leg_errors(c)
    assert found.force_std_N == pytest.approx(0.05 * 2000)
    assert found.length_std_m == pytest.approx(2e-6 / np.sqrt(12))


@pytest.mark.parametrize(
    ("fusion", "expected"),
    [
        ("{model: {coulomb_friction_N: 45}}", {"force_std_N": 15.0}),
        ("{model: {coulomb_friction_N: 90}}", {"force_std_N": 0.0}),
        ("{leg_force_std_N: 7, leg_force_time_ms: 20}", {"force_std_N": 7.0, "force_time_s": 0.02}),
        ("{length_std_m: 1e-5, rate_std_m_s: 2e-3}", {"length_std_m": 1e-5, "rate_std_m_s": 2e-3}),
    ],
)
def test_what_is_stated_counts(fusion, expected):
    found = leg_errors(fused("lab", fusion=f"  fusion: {fusion}\n"))._asdict()
    assert {name: found[name] for name in expected} == pytest.approx(expected)
