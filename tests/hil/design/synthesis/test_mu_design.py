"""The shipped mu design: mu is below 1 for its uncertainty, and real axes within it meet the weights."""

from __future__ import annotations

import itertools
from math import inf, pi
from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.app.design.command import load_design, run_design
from hil.config.design import DesignAxis, UncertaintyRanges
from hil.config.linear_controller import LinearController
from hil.design.synthesis.methods import sampled_corners
from hil.design.synthesis.mu import upper_bound
from hil.design.synthesis.structured import covers, lag_error, structured_plant, transport_error
from hil.mathematics.linear_system import LinearSystem
from tests.hil.design.synthesis.true_axes import closed, response, true_axes

ROOT = Path(__file__).resolve().parents[4]
H = 1e-3
DESIGN = load_design("mu")[0]
AXIS = DesignAxis.model_validate(DESIGN.nominal)
RANGES = UncertaintyRanges.model_validate(DESIGN.uncertainty)
LAG_S = (1 / (2 * pi * 300), 1 / (2 * pi * 120))
D, NOISE = 14.95, np.array([2.3e-5, 0.023])


def W_e(omega):
    """Inverse of the allowed error: 34.5 um at rest, rising above 0.3 rad/s, 4.6 mm above 40 rad/s."""
    s = 1j * omega
    return (s + 40.0) / (s + 40.0 * 3.45e-5 / 4.6e-3) / 4.6e-3


def W_u(omega):
    s = 1j * omega
    return (s / 500.0 + 1.0) / (8.333e-4 * s + 1.0) / 46.0


def shipped():
    return LinearController.model_validate(yaml.safe_load((ROOT / "configs/controllers/mu.yaml").read_text()))


def system(controller):
    A, B, C, D = (np.array(getattr(controller, name), float) for name in "ABCD")
    return LinearSystem(A, B, C, D, H)


@pytest.fixture(scope="module")
def made():
    lines: list[str] = []
    controller, designed, _, _ = run_design("mu", "mu", None, lines.append)
    return controller, designed, lines


def test_hil_design_reproduces_the_shipped_mu_controller(made):
    now, then = system(made[0]), system(shipped())
    omega = np.geomspace(0.1, 0.99 * pi / H, 200)  # at the Nyquist frequency both are 0 but for rounding
    assert now.response(omega) == pytest.approx(then.response(omega), rel=1e-4)
    assert made[0].design["mu_upper"] == pytest.approx(shipped().design["mu_upper"], rel=1e-4)
    assert made[0].design["uncertainty"] == shipped().design["uncertainty"]


def test_mu_of_the_shipped_design_on_a_dense_grid_is_below_1_and_matches_its_file(made):
    controller, designed, _ = made
    problem = structured_plant(DESIGN, AXIS, RANGES)
    M = problem.plant.closed_with(designed.K)
    assert M.is_stable()
    bound = upper_bound(M.response(np.geomspace(0.01, 1e5, 800)), problem.blocks, accuracy=1e-3).bound
    assert bound.max() < 1.0
    assert bound.max() == pytest.approx(controller.design["mu_upper"], rel=2e-3)


def test_uncertainty_weights_of_a_mu_design_cover_every_delay_and_lag_in_range():
    """|real / nominal - 1| <= |W|, with delay, hold, lag and Pade approximation written out."""
    omega = np.geomspace(0.5, 3e4, 700)
    s = 1j * omega
    W_delay, W_lag = (np.abs(W.response(omega)[:, 0, 0]) for W in covers(DESIGN, AXIS, RANGES))
    hold = (1 - np.exp(-s * H)) / (s * H)
    pade = (1 - s * 1.75e-3 / 2) / (1 + s * 1.75e-3 / 2)
    delay = np.array([np.abs(hold * np.exp(-s * T) / pade - 1) for T in np.linspace(0.5e-3, 2e-3, 301)])
    lag = np.array([np.abs((0.85e-3 * s + 1) / (tau * s + 1) - 1) for tau in np.linspace(*LAG_S, 301)])
    assert (delay <= W_delay).all()
    assert (lag <= W_lag).all()
    # and they are not wide: where the loop acts, by a fifth at most
    acts = omega < 600.0
    assert (W_delay < 1.2 * delay.max(0))[acts].all()
    assert (W_lag < 1.2 * lag.max(0))[acts].all()
    assert transport_error(omega, (0.5, 2.0), 1.25, 1e3, 1) == pytest.approx(delay.max(0), rel=1e-3)
    assert lag_error(omega, (1e3 * LAG_S[0], 1e3 * LAG_S[1]), 0.85) == pytest.approx(lag.max(0), rel=1e-9)


def test_every_uncertain_axis_is_a_perturbation_of_norm_1_at_most():
    """Inertia, delay, hold and lag written out, at the ends of their ranges; the inertia enters exactly."""
    omega = np.geomspace(0.5, 2e4, 50)
    s = 1j * omega
    P = structured_plant(DESIGN, AXIS, RANGES).plant.response(omega)
    W_delay, W_lag = (W.response(omega)[:, 0, 0] for W in covers(DESIGN, AXIS, RANGES))
    hold, pade = (1 - np.exp(-s * H)) / (s * H), (1 - s * 1.75e-3 / 2) / (1 + s * 1.75e-3 / 2)
    for delta, T, tau in itertools.product((-1.0, 1.0), (0.5e-3, 2e-3), LAG_S):
        of_delay = (hold * np.exp(-s * T) / pade - 1) / W_delay
        of_lag = ((0.85e-3 * s + 1) / (tau * s + 1) - 1) / W_lag
        assert max(np.abs(of_delay).max(), np.abs(of_lag).max()) <= 1.0
        Delta = np.stack([np.full(50, delta), of_delay, of_lag], 1)[:, :, None] * np.eye(3)
        seen = np.linalg.solve(np.eye(3) - P[:, :3, :3] @ Delta, P[:, :3, 3:])
        found = P[:, 3:, 3:] + P[:, 3:, :3] @ Delta @ seen  # from [d, noise, u] to [W_e e, W_u u, y]
        # acceleration from d and u; error falls by it
        a = np.stack([D + 0 * s, 0 * s, 0 * s, hold * np.exp(-s * T) / (tau * s + 1)], 1) / (1 + 0.2 * delta)
        expected = np.stack(
            [-a * (W_e(omega) / s**2)[:, None], 0 * a, -a / s[:, None] ** 2, -a / s[:, None]], axis=1
        )
        expected[:, 1, 3] = W_u(omega)
        expected[:, 2, 1], expected[:, 3, 2] = NOISE
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def weighted_loop(G, k, omega):
    """(..., 2, 3) from [d, noise] to [W_e e, W_u u]; G (..., 2, 2) from [u, d] to [position, rate]."""
    L = (k * G[..., 0]).sum(-1)
    u_d = -(k * G[..., 1]).sum(-1) / (1 + L)
    u_n = k / (1 + L)[..., None]
    e_d = -G[..., 0, 1] - G[..., 0, 0] * u_d
    e_n = -G[..., 0, :1] * u_n
    inputs = np.array([D, *NOISE])
    rows = [
        W_e(omega)[:, None] * np.concatenate([e_d[..., None], e_n], -1),
        W_u(omega)[:, None] * np.concatenate([u_d[..., None], u_n], -1),
    ]
    return np.stack(rows, -2) * inputs


def test_shipped_mu_controller_stabilises_a_thousand_axes_in_range_and_meets_all_weights():
    """Inertia, delay and lag at random and at all corners; exact delay, lag, hold; the sampled controller."""
    rng = np.random.default_rng(5)
    corners = np.array(np.meshgrid([-1, 1], [0.5e-3, 2e-3], [120, 300])).reshape(3, -1)
    delta = np.append(rng.uniform(-1, 1, 992), corners[0])
    transport = np.append(rng.uniform(0.5e-3, 2e-3, 992), corners[1])
    lag = 1 / (2 * pi * np.append(rng.uniform(120, 300, 992), corners[2]))
    K, axes = system(shipped()), true_axes(1 / (1 + 0.2 * delta), transport, lag, H)
    radius = np.abs(np.linalg.eigvals(closed(axes, K))).max(1)
    omega = np.geomspace(0.1, 0.9999 * pi / H, 80)
    k = K.response(omega)[:, 0, :]
    gain = np.linalg.svd(weighted_loop(response(axes, omega, H), k, omega), compute_uv=False)[..., 0]
    assert len(radius) == 1000
    assert radius.max() < 1.0
    assert gain.max() < shipped().design["mu_upper"] < 1.0
    assert shipped().design["norm_sampled_corners"] == pytest.approx(gain[992:].max(), rel=2e-3)
    assert gain.max() > 0.9, "the bound is not met by a loop that does nothing"


def test_disturbance_step_under_the_mu_controller_moves_every_axis_by_less_than_2_mm():
    """Weights bound the response in frequency; in time it meets the platform's limits: 2 mm, 50 um after 0.3 s."""
    delta, T, bandwidth = np.array(np.meshgrid([-1, 0, 1], [0.5e-3, 1.25e-3, 2e-3], [120, 300])).reshape(
        3, -1
    )
    K, axes = system(shipped()), true_axes(1 / (1 + 0.2 * delta), T, 1 / (2 * pi * bandwidth), H)
    A = closed(axes, K)
    B, x, error = np.zeros(A.shape[:2]), np.zeros(A.shape[:2]), []
    B[:, : axes.A.shape[1]] = D * axes.B[:, :, 1]
    for _ in range(1000):
        x = np.einsum("nij,nj->ni", A, x) + B
        error.append(np.abs(x[:, 2]))
    assert 1e-3 < np.max(error) < 2e-3
    assert np.max(error[300:]) < 5e-5


def test_the_corner_check_finds_a_loop_that_is_unstable_when_sampled():
    worst = sampled_corners(DESIGN, AXIS, RANGES, system(shipped()))
    assert worst == pytest.approx(shipped().design["norm_sampled_corners"], rel=1e-6)
    wider = RANGES.model_copy(update={"transport_ms": (0.5, 9.0)})
    assert sampled_corners(DESIGN, AXIS, wider, system(shipped())) == inf


def test_mu_is_proven_at_all_frequencies_and_not_only_on_the_grid():
    """Rational scales: the norm of D M D^-1, by the Hamiltonian, is a bound at all frequencies."""
    design = shipped().design
    assert design["mu_upper"] <= design["mu_proven"] < 1.02 * design["mu_upper"] < 1.0
