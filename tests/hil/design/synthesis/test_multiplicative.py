"""Uncertainty of measured axes: its bound, its cover, and the robustness of single and coupled loops."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import ConfigurationError, SynthesisError
from hil.app.configuration.section_file import read_section
from hil.app.design.command import axis_of, load_design, report, run_design
from hil.config.axis_model import AxisModel
from hil.design.synthesis.axis import loop_gain, sampled_axis
from hil.design.synthesis.methods import design_mu
from hil.design.synthesis.multiplicative import Relative, frequencies, margin, relative
from tests.hil.design.synthesis.test_coupling import gamma

RATE_HZ = 1000.0
FLAT = 0.25 * 2 * np.pi * RATE_HZ
GAINS = [1.02, 0.99, 1.0, 1.01, 0.98, 1.0]
AXES = f"""\
kind: axis-model
source: a log
axes: joint
rate_Hz: 1000
nominal: {{gain: {GAINS}, transport_ms: 0.52, lag_ms: 0.81}}
uncertainty: {{frequency_Hz: [1, 10, 30, 100], bound: [0.045, 0.01, 0.03, 0.09]}}
measured:
"""
ONE = "- {frequency_Hz: [1], magnitude: [0.025], phase_deg: [-180], coherence: [1], magnitude_std: [0], phase_std_deg: [0]}\n"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "axes.yaml"
    path.write_text(AXES + 6 * ONE)
    return path


def loop(designed, axis, design):
    return loop_gain(designed.judged.sampled, sampled_axis(axis, RATE_HZ, design.inputs))


def profile(*points, flat=FLAT):
    hertz, bound = np.array(points).T
    return Relative(2 * np.pi * hertz, bound, flat)


def test_common_uncertainty_bound_covers_every_measured_axis_with_its_own_uncertainty(file):
    model = read_section(file, AxisModel)[0]
    found = relative(model, 1.0)
    circle = np.exp(2j * np.pi * np.arange(720) / 720)
    for w, own in zip(found.bound, model.uncertainty.bound, strict=True):
        farthest = max(np.abs(g * (1 + own * circle) - 1).max() for g in GAINS)
        assert farthest <= w * (1 + 1e-12)
        assert w == pytest.approx(farthest, rel=1e-4)


def test_coupled_axes_are_stable_for_every_uncertainty_in_their_margin():
    _, designed, design, axis = run_design("hinf", "hinf", None, lambda _: None)
    L, w = loop(designed, axis, design), profile((1, 0.3), (100, 0.3))
    Gamma = gamma(230.0, (0.5, 0.3, 0.5))
    alone, coupled = margin(w, L, RATE_HZ), margin(w, L, RATE_HZ, [Gamma])
    assert margin(w, L, RATE_HZ, [np.eye(6)]).norm == pytest.approx(alone.norm, rel=1e-3)
    assert coupled.norm > 1.05 * alone.norm
    omega = frequencies(RATE_HZ)[::40]
    draw, smallest = np.random.default_rng(1), np.inf
    for x, bound in zip(L.response(omega)[:, 0, 0], w.at(omega), strict=True):
        phases = np.exp(2j * np.pi * draw.random((300, 6)))
        for size in (0.99 / coupled.norm, 0.5 / coupled.norm):
            real = np.eye(6) + bound * size * phases[:, :, None] * np.eye(6)
            smallest = min(smallest, np.abs(np.linalg.det(np.eye(6) + x * Gamma @ real)).min())
    assert smallest > 1e-3, "no perturbation of this size brings an eigenvalue of the loop to -1"


@pytest.mark.long
def test_mu_design_treats_measured_uncertainty_as_a_separate_block():
    design, _ = load_design("mu")
    axis = design.nominal
    assert axis is not None
    error = design.weights.error.model_copy(update={"low_m": 7e-5, "peak_m": 9e-3})
    modest = design.model_copy(update={"weights": design.weights.model_copy(update={"error": error})})
    plain = design_mu(modest, axis, lambda _: None)
    measured = profile((1, 0.045), (10, 0.01), (100, 0.09))
    made = design_mu(modest, axis, lambda _: None, measured)
    assert plain.figures["mu_upper"] < made.figures["mu_upper"] < 1
    assert margin(measured, loop(made, axis, modest), RATE_HZ).norm < 1


def test_design_report_states_the_robustness_margin_to_measured_axes(file):
    axis, measured = axis_of(load_design("hinf")[0], file.parent, file)
    assert measured is not None
    assert axis.gain == pytest.approx(1.0, abs=0.01)
    controller, designed, design, axis = run_design("hinf", "hinf", file, lambda _: None)
    left = controller.design["measured"]
    again = margin(measured, loop(designed, axis, design), RATE_HZ)
    assert left == {"norm": again.norm, "at_rad_s": again.at_rad_s}
    hertz = again.at_rad_s / (2 * np.pi)
    (line,) = (line for line in report(controller) if "|W T|" in line)
    assert f"{again.norm:.3f}, nearest to 1 at {hertz:.3g} Hz" in line


def test_design_for_measured_axes_too_uncertain_for_any_loop_is_refused(file):
    file.write_text((AXES + 6 * ONE).replace("[0.045, 0.01, 0.03, 0.09]", "[0.045, 1.3, 1.5, 3.0]"))
    with pytest.raises(
        SynthesisError, match=r"gamma is .* allowed: below 1|differ from the nominal one by more"
    ):
        run_design("hinf", "hinf", file, lambda _: None)


@pytest.mark.parametrize(
    ("robot", "says"),
    [("bench", "six uncoupled legs"), ("vcan50", "loop.rate_Hz: 50, allowed: as in the design, 1000")],
)
def test_design_for_a_robot_configuration_with_another_loop_is_refused(robot, says):
    with pytest.raises(ConfigurationError, match=says):
        run_design("hinf", "hinf", None, lambda _: None, robot)
