"""Calibration recovers a perturbed robot within the reported uncertainty, and lists undetermined parameters."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest, norm

from drivers.errors import CalibrationError
from hil.lab.calibrate.fit import Measurements, calibrate, suspicion
from hil.robot.geometry import Platform

HEXAGON = np.deg2rad([-10, 10, 110, 130, 230, 250])
NOMINAL = Platform.from_dict(
    {
        "base_joints": np.stack([0.75 * np.cos(HEXAGON), 0.75 * np.sin(HEXAGON), 0 * HEXAGON], axis=1),
        "platform_joints": [
            [0.6 * np.cos(t), 0.6 * np.sin(t), 0.0] for t in np.deg2rad([310, 50, 70, 170, 190, 290])
        ],
        "platform": {"mass": 1.0, "com": [0, 0, 0], "inertia": np.eye(3)},
        "cylinder": {"mass": 0.0, "com": 0.0, "inertia_axial": 0.0, "inertia_transverse": 0.0},
        "rod": {"mass": 0.0, "com": 0.0, "inertia_axial": 0.0, "inertia_transverse": 0.0},
        "gravity": [0, 0, -9.81],
    }
)


def synthetic(seed, n=40, length=2e-5, position=0.0, rotation=0.0, tilt_deg=12.0, move=0.12):
    """A perturbed robot and its measured pairs; lengths by scipy's rotations, leg by leg."""
    g = np.random.default_rng(seed)
    a = NOMINAL.base_joints + g.normal(0, 2e-3, (6, 3))
    b = NOMINAL.platform_joints + g.normal(0, 2e-3, (6, 3))
    offset = g.normal(0, 5e-3, 6)
    p = np.array([0, 0, 0.85]) + g.uniform(-move, move, (n, 3))
    R = Rotation.from_rotvec(np.deg2rad(g.uniform(-tilt_deg, tilt_deg, (n, 3))))
    q = np.empty((n, 6))
    for k in range(n):
        for i in range(6):
            q[k, i] = np.sqrt(np.sum((p[k] + R[k].apply(b[i]) - a[i]) ** 2)) + offset[i]
    q += g.normal(0, length, (n, 6))
    p = p + g.normal(0, 1, (n, 3)) * position
    R = Rotation.from_rotvec(g.normal(0, 1, (n, 3)) * rotation) * R
    measured = Measurements(
        p,
        R.as_rotvec(),
        q,
        np.full(n, length),
        np.full(n, position),
        np.full(n, rotation),
    )
    return np.hstack([a, b, offset[:, None]]), measured


def unweighted(measured):
    return Measurements(measured.p, measured.rotation_vector, measured.q)


def estimate(fit):
    return np.hstack([fit.base_joints, fit.platform_joints, fit.offsets[:, None]])


def test_calibration_recovers_the_robot_from_exact_poses_and_lengths():
    true, measured = synthetic(1, length=0.0)
    fit = calibrate(NOMINAL, unweighted(measured))
    assert estimate(fit) == pytest.approx(true, abs=1e-9)
    assert np.abs(fit.residuals).max() < 1e-12
    assert fit.dof == 6 * 40 - 42
    assert fit.undetermined == []


@pytest.mark.parametrize(
    "kind", [{}, {"position": 3e-5, "rotation": 6e-5}], ids=["lengths noisy", "poses noisy, too"]
)
def test_calibration_errors_agree_with_the_reported_uncertainty(kind):
    """Over seeds: normalised errors have a standard normal distribution; chi-square has its own."""
    errors, energy, chi_square = [], [], []
    for seed in range(40):
        true, measured = synthetic(seed, **kind)
        fit = calibrate(NOMINAL, measured)
        error = (estimate(fit) - true).ravel()
        errors.append(error / fit.std.ravel())
        energy.append(error @ np.linalg.solve(fit.covariance, error))
        chi_square.append(fit.chi_square)
        assert fit.p_value == pytest.approx(chi2.sf(fit.chi_square, fit.dof), rel=1e-9)
    z = np.array(errors)
    # 1680 normalised errors, those of a leg correlated: 0.27 % lie outside 3 sigma.
    assert np.mean(np.abs(z) > 3) < 0.01
    assert 0.93 < np.sqrt(np.mean(z**2)) < 1.07
    assert kstest(z[:, 0], norm.cdf).pvalue > 1e-3
    # all 42 together: error^T C^-1 error is chi-square with 42 degrees of freedom
    assert kstest(energy, chi2(42).cdf).pvalue > 1e-3
    assert kstest(chi_square, chi2(198).cdf).pvalue > 1e-3


def test_calibration_estimates_the_measurement_deviation_from_residuals_if_not_given():
    sigma, scaled = [], []
    for seed in range(20):
        true, measured = synthetic(seed)
        fit = calibrate(NOMINAL, unweighted(measured))
        assert fit.chi_square is None
        sigma.append(fit.sigma)
        scaled.append((estimate(fit) - true) / fit.std)
    assert np.mean(sigma) == pytest.approx(2e-5, rel=0.05)
    assert 0.9 < np.sqrt(np.mean(np.square(scaled))) < 1.1


@pytest.mark.parametrize("noise", [{}, {"position": 2e-5, "rotation": 5e-5}], ids=["exact", "noisy"])
def test_calibration_without_tilted_poses_reports_common_joint_shifts_as_undetermined(noise):
    true, measured = synthetic(2, tilt_deg=0.0, **noise)
    fit = calibrate(NOMINAL, measured)
    assert fit.dof == 240 - 24
    named = {(c.leg, tuple(sorted(c.coefficients))) for c in fit.undetermined}
    assert named == {(leg, (f"base {x}", f"platform {x}")) for leg in range(6) for x in "xyz"}
    for c in fit.undetermined:
        assert all(v == pytest.approx(1, abs=0.05) for v in c.coefficients.values())
    assert np.isnan(fit.std[:, :6]).all()
    assert np.isfinite(fit.std[:, 6]).all()
    # the difference is determined nevertheless, the sum is as it was
    x = estimate(fit)
    between = (x[:, 3:6] - x[:, 0:3]) - (true[:, 3:6] - true[:, 0:3])
    assert np.abs(between).max() < 0.02
    nominal = NOMINAL.base_joints + NOMINAL.platform_joints
    assert x[:, 0:3] + x[:, 3:6] == pytest.approx(nominal, abs=1e-9 if not noise else 2e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: Measurements(m.p * 1e3, m.rotation_vector, m.q), "positions are in mm"),
        (lambda m: Measurements(m.p, m.rotation_vector, m.q * 1e3), "lengths are in mm"),
        (lambda m: Measurements(m.p * 1e3, m.rotation_vector, m.q * 1e3), "positions and lengths are in mm"),
        (lambda m: Measurements(m.p, np.deg2rad(m.rotation_vector), m.q), "are in rad instead of deg"),
        (
            lambda m: Measurements(
                -Rotation.from_rotvec(m.rotation_vector).inv().apply(m.p), -m.rotation_vector, m.q
            ),
            "poses are inverse",
        ),
    ],
)
def test_calibration_recognises_poses_in_a_wrong_unit_or_direction(change, words):
    _, measured = synthetic(7)
    assert suspicion(NOMINAL, measured) is None
    assert words in (suspicion(NOMINAL, change(measured)) or "")


def test_calibration_with_fewer_than_8_poses_is_refused():
    _, m = synthetic(8, n=7)
    with pytest.raises(CalibrationError, match="7 poses, allowed: at least 8"):
        calibrate(NOMINAL, m)
    _, m = synthetic(8, n=8)
    assert calibrate(NOMINAL, m).dof == 6
