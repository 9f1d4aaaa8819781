"""Masses and friction from synthetic motion: forces from the loop's model, with known load and friction."""

from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.errors import IdentificationError
from hil.lab.identify.estimators.body_fit import (
    coloured_covariance,
    consistent,
    solve,
    unknowns_scale,
)
from hil.lab.identify.estimators.leg_equations import (
    COLUMNS,
    COULOMB,
    LATE,
    REFLECTED,
    VISCOUS,
    equations_of,
)
from hil.lab.identify.estimators.leg_motion import LegSignals
from hil.lab.identify.estimators.rigid_body import SIZE, body_of, parameters_of, pseudo_inertia
from hil.robot.dynamics import Model
from hil.robot.geometry import Body, Platform
from hil.robot.inertia import combine, physical
from hil.robot.kinematics import leg_lengths
from tests.hil.lab.identify.test_identify_leg_motion import PLATFORM, T, state
from tests.hil.test_dynamics import BOOK

LOAD = Body(230.0, np.array([0.5, 0.3, 0.5]), np.diag([11.7, 7.9, 9.97]))
LADEN = Platform.from_dict(
    {
        **BOOK["geometry"],
        "platform": {k: np.asarray(v).tolist() for k, v in vars(combine([PLATFORM.platform, LOAD])).items()},
    }
)
BELIEVED: Array = np.zeros(COLUMNS)
BELIEVED[:SIZE] = parameters_of(PLATFORM.platform)
SCALE = unknowns_scale(PLATFORM)
FRICTION: dict[str, Any] = {
    "viscous": np.array([200.0, 180.0, 220.0, 150.0, 300.0, 90.0]),
    "coulomb": np.array([60.0, 50.0, 40.0, 80.0, 30.0, 20.0]),
    "reflected_mass": np.array([9.9, 20.0, 5.0, 12.0, 0.0, 30.0]),
}


def made(model, seconds=6.0, axes=range(6), late_s=0.0):
    """Signals of a noiseless log of a motion; the forces are those of `late_s` earlier."""
    states = [state(k * T, axes) for k in range(round(seconds / T))]
    force = [model.inverse_dynamics(*state(k * T - late_s, axes)) for k in range(len(states))]
    length = np.array([leg_lengths(PLATFORM, p, R) for p, R, _, _ in states])
    return LegSignals(
        T,
        length,
        length,
        np.array(force),
        np.array([s[0] for s in states]),
        np.array([s[1] for s in states]),
        np.ones(len(states), bool),
    )


def fitted(signals):
    return solve(equations_of(Model(PLATFORM), signals), BELIEVED, SCALE)


@pytest.fixture(scope="module")
def laden():
    return made(Model(LADEN, **FRICTION), late_s=3e-4)


@pytest.mark.long
def test_platform_friction_reflected_mass_and_delay_are_found_together(laden):
    """The remaining error comes from a filter of 20 ms on a nonlinear model."""
    found = fitted(laden)
    body = parameters_of(LADEN.platform)
    assert found.theta[0] == pytest.approx(1380.0, rel=1e-4)
    assert np.abs(found.theta[1:4] - body[1:4]).max() < 1e-3 * 115.0
    assert np.abs(found.theta[4:SIZE] - body[4:]).max() < 1e-3 * 660.0
    assert found.theta[VISCOUS : VISCOUS + 6] == pytest.approx(FRICTION["viscous"], abs=1.0)
    assert found.theta[COULOMB : COULOMB + 6] == pytest.approx(FRICTION["coulomb"], abs=0.5)
    assert found.theta[REFLECTED:] == pytest.approx(FRICTION["reflected_mass"], abs=0.3)
    assert found.theta[LATE] == pytest.approx(3e-4, abs=1e-5)
    assert not found.hidden.size
    assert found.condition < 20.0


def test_parameters_not_observable_from_vertical_motion_stay_as_configured():
    """Vertical motion shows the mass and its horizontal position, but neither its height nor the inertia."""
    found = fitted(made(Model(LADEN), 6.0, axes=[2]))
    assert found.theta[0] == pytest.approx(1380.0, rel=1e-3)
    assert found.theta[1:3] == pytest.approx([115.0, 69.0], abs=0.2)
    assert found.theta[3:SIZE] == pytest.approx(BELIEVED[3:SIZE], abs=1e-6)
    assert (found.unknown[3:SIZE] > 0.9).all()
    assert (found.unknown[:3] < 0.1).all()


def test_payload_identification_refuses_a_leg_that_never_slides():
    signals = made(Model(PLATFORM), 2.0)
    still = np.tile(signals.length[:1], (len(signals.length), 1))
    with pytest.raises(IdentificationError, match=r"too little motion: leg 0 has .* usable samples"):
        fitted(
            signals._replace(
                length=still, reference=still, p=signals.p * 0 + signals.p[0], R=signals.R * 0 + signals.R[0]
            )
        )


def noisy(signals, rng, sigma_m=5e-6, sigma_N=3.0):
    shape = signals.length.shape
    return signals._replace(
        length=signals.length + rng.normal(0.0, sigma_m, shape),
        force=signals.force + rng.normal(0.0, sigma_N, shape),
    )


def test_point_mass_payload_is_identified_as_a_physically_possible_body():
    point = Body(230.0, np.array([0.5, 0.3, 0.5]), 1e-9 * np.eye(3))
    whole = combine([PLATFORM.platform, point])
    keys = {k: np.asarray(v).tolist() for k, v in vars(whole).items()}
    signals = made(Model(Platform.from_dict({**BOOK["geometry"], "platform": keys})), 4.0)
    estimate = fitted(noisy(signals, np.random.default_rng(2)))
    found = consistent(estimate, PLATFORM.radius, BELIEVED[:SIZE])
    assert found.smallest < 0.0
    body = found.theta[:SIZE] - BELIEVED[:SIZE]
    assert np.linalg.eigvalsh(pseudo_inertia(body)).min() > 0.0
    assert physical(body_of(body).inertia)
    assert body[0] == pytest.approx(230.0, rel=2e-3)
    assert body_of(body).com == pytest.approx([0.5, 0.3, 0.5], abs=2e-3)
    assert 0.0 < found.shift < 4.0


@pytest.mark.parametrize(
    ("series", "white_over_spread"),
    [
        (lambda rng, n: np.diff(rng.normal(0.0, 1.0, n + 2), 2), (5.0, np.inf)),
        (lambda rng, n: np.convolve(rng.normal(0.0, 1.0, n + 99), np.ones(100), "valid"), (0.0, 0.3)),
    ],
    ids=["differentiated", "slow"],
)
def test_standard_error_of_the_payload_with_coloured_noise_has_the_right_size(series, white_over_spread):
    """A sine in coloured noise; the formula for white noise would overstate or understate its error."""
    rng, n = np.random.default_rng(8), 4000
    Z = np.sin(2 * np.pi * 0.002 * np.arange(n))[:, None]
    found, said, white = [], [], []
    for _ in range(60):
        noise = series(rng, n)
        x = float(Z[:, 0] @ noise / (Z[:, 0] @ Z[:, 0]))
        residual = noise - Z[:, 0] * x
        found.append(x)
        said.append(coloured_covariance(Z, residual, np.arange(n))[0, 0])
        white.append(residual.var() / (Z[:, 0] @ Z[:, 0]))
    assert 0.5 < np.sqrt(np.mean(said)) / np.std(found) < 2.0
    low, high = white_over_spread
    assert low < np.sqrt(np.mean(white)) / np.std(found) < high


@pytest.mark.long
def test_standard_errors_of_the_payload_agree_with_the_spread_over_seeds():
    """Only encoder and force noise, for each unknown. Both figures are known to some 15 %."""
    signals = made(Model(LADEN, **FRICTION), 6.0)
    found = [fitted(noisy(signals, np.random.default_rng(seed))) for seed in range(30)]
    ratio = np.sqrt(np.mean([f.std**2 for f in found], axis=0)) / np.std(
        [f.theta for f in found], axis=0, ddof=1
    )
    assert 0.7 < np.median(ratio) < 1.4
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0
