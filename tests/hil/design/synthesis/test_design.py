"""Designs: the command reproduces the shipped ones, they reach their gamma, and infeasible ones are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from drivers.errors import SynthesisError
from hil.app.design.command import METHODS, run_design
from hil.config.design import Design
from hil.config.linear_controller import LinearController
from hil.design.stability.sampled_loop import grid
from hil.design.synthesis.axis import generalised_plant, sampled_axis
from hil.design.synthesis.norm import gains, norm
from hil.design.synthesis.weights import control_weight, error_weight, noise
from hil.mathematics.linear_system import LinearSystem

ROOT = Path(__file__).resolve().parents[4]
SHIPPED = ("hinf", "constant_hinf")


def shipped(name):
    return LinearController.model_validate(
        yaml.safe_load((ROOT / f"configs/controllers/{name}.yaml").read_text())
    )


def system(controller):
    A, B, C, D = (np.array(getattr(controller, name), float) for name in "ABCD")
    return LinearSystem(A, B, C, D, 1.0 / controller.rate_Hz)


@pytest.fixture(scope="module", params=SHIPPED)
def made(request):
    """(name, controller, designed, design, axis) as computed now."""
    controller, designed, design, axis = run_design("hinf", request.param, None, lambda _: None)
    return request.param, controller, designed, design, axis


def test_hil_design_reproduces_each_shipped_controller(made):
    name, controller, *_ = made
    file = shipped(name)
    for key in ("A", "B", "C", "D", "anti_windup"):
        now, then = np.array(getattr(controller, key)), np.array(getattr(file, key))
        np.testing.assert_allclose(now, then, rtol=1e-6, atol=1e-6 * np.abs(then).max(), err_msg=key)
    for key in ("gamma", "gamma_opt", "norm", "norm_sampled", "crossover_rad_s", "phase_margin_deg"):
        assert controller.design[key] == pytest.approx(file.design[key], rel=1e-6), key
    for key in ("weights", "axis", "delay_order", "lump_lag"):
        assert controller.design[key] == file.design[key]


def test_gamma_is_within_a_tenth_of_the_optimum_and_all_weights_are_met(made):
    gamma, best = made[1].design["gamma"], made[1].design["gamma_opt"]
    assert best < gamma <= 1.1 * best * (1 + 1e-9)
    assert gamma <= 1.0


def test_the_loop_and_not_the_noise_at_rest_limits_the_optimum(made):
    """At rest the encoder error remains: no controller is better than error_m / low_m."""
    _, controller, _, design, _ = made
    weights = design.weights
    at_rest = weights.noise.error_m / weights.error.low_m
    assert controller.design["gamma_at_rest"] == pytest.approx(at_rest, rel=1e-9)
    assert controller.design["gamma_opt"] > 1.1 * at_rest


def test_the_norm_of_the_continuous_loop_is_below_gamma(made):
    _, controller, designed, design, axis = made
    closed = generalised_plant(design, axis).closed_with(designed.K)
    top = gains(closed, np.geomspace(1e-3, 1e6, 6_000)).max()
    assert top / (1 + 3e-6) <= norm(closed) < controller.design["gamma"]


def test_the_norm_of_the_sampled_loop_exceeds_gamma_by_at_most_1_percent(made):
    """The controller of the file with exact hold and delay, weights at j w, d a sinusoid in continuous time."""
    name, _, _, design, axis = made
    K, legs = system(shipped(name)), sampled_axis(axis, design.rate_Hz, design.inputs)
    omega = np.concatenate([np.geomspace(1e-3, 1.0, 200), grid(1e-3)[::4]])
    s = 1j * omega
    k = K.response(omega)  # (w, 1, inputs)
    P = legs.response(omega)[:, 0, 1]  # u to e at the ticks
    P_y = legs.response(omega)[:, 1:, 1]
    of_d = np.stack([-1 / s**2, -1 / s], axis=1)  # d to e and e', which sampling does not change
    S = 1.0 / (1.0 - (k[:, 0] * P_y).sum(axis=1))
    causes = np.concatenate(
        [of_d[:, :, None], np.broadcast_to(np.eye(2), (len(s), 2, 2))], axis=2
    )  # y of [d, n]
    u = S[:, None] * np.einsum("wi,wij->wj", k[:, 0], causes)
    e = P[:, None] * u + np.stack([of_d[:, 0], 0 * s, 0 * s], axis=1)
    W_e = error_weight(design.weights.error).response(omega)[:, 0]
    W_u = control_weight(design.weights.control, design.rate_Hz).response(omega)[:, 0]
    into = np.array([design.weights.disturbance.amplitude_m_s2, *noise(design)])
    M = np.stack([W_e * e, W_u * u], axis=1) * into
    assert np.linalg.svd(M, compute_uv=False).max() <= 1.01 * shipped(name).design["gamma"]
    assert legs.closed_with(K).is_stable()


def changed(**changes):
    """The shipped design with values replaced, by dotted path."""
    document = yaml.safe_load((ROOT / "configs/designs/hinf.yaml").read_text())
    for path, value in changes.items():
        *parents, key = path.split("__")
        section = document
        for parent in parents:
            section = section[parent]
        section[key] = value
    return Design.model_validate(document)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"weights__error__low_m": 4e-6}, "no controller meets the weights.*noise of"),
        (
            {"weights__control__limit_m_s2": 8},
            "no controller meets the weights.*disturbance to control",
        ),
        ({"weights__noise__rate_error_m_s": 1e-4}, "pole of the controller at .* half the Nyquist"),
        (
            {"weights__error": {"numerator": [1], "denominator": [1, -3]}},
            "weights.error: unstable, a pole at 3",
        ),
        (
            {"weights__error": {"numerator": [1, 1], "denominator": [2]}},
            "weights.error: improper.*degree 1 over",
        ),
        ({"weights__control": {"numerator": [1], "denominator": [1, 5]}}, "weights.control: rolls off"),
        ({"nominal__drive": {"numerator": [1, 0, 0], "denominator": [1, 1]}}, "nominal.drive: improper"),
        ({"nominal__drive": {"numerator": [3], "denominator": [1e-3, 1]}}, "nominal.drive: gain 3 at rest"),
        ({"nominal__transport_ms": 6.0}, "no controller"),
    ],
)
def test_an_infeasible_design_is_refused_with_the_reason(changes, says):
    design = changed(**changes)
    assert design.nominal is not None
    with pytest.raises(SynthesisError, match=says):
        METHODS["hinf"](design, design.nominal, lambda _: None, None)
