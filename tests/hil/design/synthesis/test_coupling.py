"""Axes coupled by an inertia error: the poles of the loop are those of one axis at the eigenvalues of Gamma."""

from __future__ import annotations

import numpy as np
import pytest

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from tests.hil.design.synthesis.test_mu_design import H, shipped, system
from tests.hil.design.synthesis.true_axes import PAST, closed, true_axes

T, LAG = 1.25e-3, 0.85e-3
PAYLOADS = [
    (230.0, (0.0, 0.0, 0.0)),
    (230.0, (0.5, 0.3, 0.5)),
    (-200.0, (0.1, 0.0, 0.1)),
    (5000.0, (1.0, 1.0, 1.0)),
]
"""Mass, kg, missing in the law's model, and its position, m; negative: mass in the model only."""


def gamma(mass_kg, at_m):
    """J M^-1 M_model J^-1 of the book's platform at home."""
    c = load("virtual")
    platform = build_platform(c.platform)
    p, R = pose_arrays(c.platform.home)
    J, believed = jacobian(platform, p, R), Model(platform).mass_matrix(p, R)
    x = R @ np.array(at_m)
    across = np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])
    point = np.hstack([np.eye(3), -across])
    M = believed + mass_kg * point.T @ point
    assert np.linalg.eigvalsh(M).min() > 0
    return J @ np.linalg.solve(M, believed) @ np.linalg.inv(J)


def coupled(G, K):
    """Loop matrix of six axes with drives coupled by G (6, 6), each with controller K.

    An axis is affine in its gain: the part with the gain is coupled, the rest is separate for each axis.
    """
    own, per_gain = true_axes(0.0, [T], [LAG], H), true_axes(1.0, [T], [LAG], H)
    A0, A1 = own.A[0], per_gain.A[0] - own.A[0]
    b0, b1 = own.B[0, :, :1], (per_gain.B - own.B)[0, :, :1]
    A, B = np.kron(np.eye(6), A0) + np.kron(G, A1), np.kron(np.eye(6), b0) + np.kron(G, b1)
    C = np.zeros((2, 3 + PAST))
    C[0, 2] = C[1, 1] = -1.0
    six = [np.kron(np.eye(6), each) for each in (K.A, K.B @ C, K.C, K.D @ C)]
    return np.block([[A + B @ six[3], B @ six[2]], [six[1], six[0]]])


def nearest(these, those):
    """Largest distance of a number in `these` to its nearest number in `those`."""
    return np.abs(these[:, None] - those[None, :]).min(axis=1).max()


@pytest.mark.parametrize(("mass_kg", "at_m"), PAYLOADS)
def test_the_eigenvalues_of_Gamma_are_real_and_positive(mass_kg, at_m):
    G = gamma(mass_kg, at_m)
    found = np.linalg.eigvals(G)
    assert np.abs(found.imag).max() < 1e-12
    assert found.real.min() > 0
    assert np.abs(G - np.diag(np.diag(G))).max() > 1e-3, "the axes are coupled"


@pytest.mark.parametrize(("mass_kg", "at_m"), PAYLOADS)
def test_coupled_poles_are_those_of_one_axis_at_Gammas_eigenvalues(mass_kg, at_m):
    K, G = system(shipped()), gamma(mass_kg, at_m)
    gains = np.linalg.eigvals(G).real
    single = np.concatenate([np.linalg.eigvals(A) for A in closed(true_axes(gains, T, LAG, H), K)])
    together = np.linalg.eigvals(coupled(G, K))
    assert len(single) == len(together)
    assert max(nearest(single, together), nearest(together, single)) < 1e-5
    assert (np.abs(together).max() < 1.0) == (np.abs(single).max() < 1.0)
