"""`hil tune`: tuned gains against the plant's true lengths, closed forms of the loop, and refusals."""

from __future__ import annotations

import json
from math import atan, pi, sqrt
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.simulation import sim
from hil.cli import main
from hil.control.law import LawSettings
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.study.tune import RULE, by_rule, delays_of, figures_of, tune, with_gains
from tests.broad import broad

UNWATCHED = {"monitor": {"action": "log"}}
SCREWS = "docs/examples/screw_robot.yaml"


@pytest.fixture(scope="module")
def tuned_lab():
    return tune(load("lab"))


def true_peak_mm(config, changes, folder):
    """Largest q_d - true length of a leg while tracking, from the two logs of a run."""
    run = sim(config, duration_s=6.0, log=folder / f"{len(str(changes))}.mcap", check_replay=False, **changes)
    assert run.success
    ticks = run.log.frame("mode", "q_d", "plant.length")
    on_path = ticks[ticks["mode"] == "TRACKING"]
    return 1e3 * max(
        np.abs(on_path[f"q_d.leg_{k}"] - on_path[f"plant.length.leg_{k}"]).max() for k in range(6)
    )


@pytest.mark.parametrize("config", broad(["lab", "virtual", "desktop", SCREWS], quick=1))
def test_tuned_gains_halve_the_true_peak_error_at_no_smaller_delay_margin(config, tmp_path):
    """Against the gains that `hil new` writes, from the plant's own log of separate simulations."""
    found = tune(load(config))
    assert found["gains"]["tuned"]["delay_margin_ms"] >= found["gains"][RULE]["delay_margin_ms"]
    law: Any = by_rule(load(config)).controller
    before = {"controller": {"wn_rad_s": law.wn_rad_s, "damping_ratio": 1.0, "model": None}}
    if law.model.reflected_mass_kg:
        before["controller"]["model"] = {
            "reflected_mass_kg": law.model.reflected_mass_kg,
            **dict.fromkeys(("coulomb_friction_N", "viscous_friction_N_s_m"), None),
        }
    assert true_peak_mm(config, found["block"], tmp_path) < 0.5 * true_peak_mm(config, before, tmp_path)


def test_delay_margin_of_the_rule_is_that_of_a_double_integrator_less_its_delay():
    """PD on 1 / s^2: crossover 2.058 wn, phase atan(2 zeta w_c / wn), Astrom and Murray, Feedback Systems."""
    c: Any = by_rule(load("virtual"))
    wn, delays = c.controller.wn_rad_s, delays_of(c)
    crossover = wn * sqrt(2.0 + sqrt(5.0))
    margin_ms = 1e3 * atan(2.0 * crossover / wn) / crossover - sum(delays[:3])
    assert figures_of(c, delays)["delay_margin_ms"] == pytest.approx(margin_ms, rel=0.02)


def test_force_noise_is_that_of_random_readings_between_the_steps_of_encoder_and_frames():
    """Steps: 0.15 um (configs/lab.yaml), 0.1 um and 0.1 um/s (legs.dbc); the heaviest motion of all legs."""
    c = load("lab")
    found, rng = figures_of(c, delays_of(c)), np.random.default_rng(1)
    encoder, length, rate = rng.uniform(-0.5, 0.5, (3, 100_000)) * [[1.5e-7], [1e-7], [1e-7]]
    acceleration = 40.0**2 * (encoder + length) + 2.0 * 40.0 * rate
    platform, home = build_platform(c.platform), pose_arrays(c.platform.home)
    to_legs = np.linalg.inv(jacobian(platform, *home))
    heaviest_kg = np.linalg.eigvalsh(to_legs.T @ Model(platform).mass_matrix(*home) @ to_legs).max()
    assert found["force_noise_N"] == pytest.approx(heaviest_kg * float(acceleration.std()), rel=0.02)


def test_printed_block_is_a_valid_change_that_knows_the_friction_of_the_plant(tuned_lab):
    lab: Any = load("lab")
    c: Any = loads(with_changes(lab.text, tuned_lab["block"]), "tuned", lab.folder)
    assert c.controller.model.coulomb_friction_N == lab.plant.model.coulomb_friction_N == 60.0
    assert c.controller.lookahead.bus_ms == tuned_lab["delays"]["bus_ms"]


def test_limit_of_faster_gains_is_printed_with_its_value(tuned_lab):
    assert any("delay margin" in line and "at least" in line for line in tuned_lab["limit"])


def test_smaller_required_delay_margin_gives_a_stiffer_loop(tuned_lab):
    stiffer = tune(load("lab"), delay_margin_ms=8.0)["gains"]["tuned"]
    assert stiffer["delay_margin_ms"] >= 8.0
    assert stiffer["disturbed_error_mm"] < 0.5 * tuned_lab["gains"]["tuned"]["disturbed_error_mm"]


def test_stated_delay_of_the_configuration_is_taken_as_it_is():
    lab = load("lab")
    stated = {"controller": {"delay_compensation": {"bus_ms": 0.53, "drive_lag_ms": 0.76, "hold_ms": 0.5}}}
    delays = delays_of(loads(with_changes(lab.text, stated), "stated", lab.folder))
    assert delays[:3] == (0.53, 0.76, 0.5)


@pytest.mark.parametrize("law", ["pid", "sliding_mode", "pose_inverse_dynamics"])
def test_other_laws_with_gains_are_tuned_within_the_same_margin(law):
    c = loads(with_changes(load("lab").text, {"controller": OTHERS[law], **UNWATCHED}), law)
    found = tune(c.model_copy(update={"plant": None}))
    assert found["gains"]["tuned"]["delay_margin_ms"] >= found["delay_margin_ms"]
    assert found["limit"]


OTHERS = {
    "pid": {"law": "pid", "kp_N_m": 1e5, "kv_N_s_m": 5e3, "ki_N_m_s": 1e5, "integral_limit_N": 2000},
    "sliding_mode": {
        "law": "sliding_mode",
        "lambda_rad_s": 20,
        "uncertainty": {"disturbance_m_s2": 4},
        "reaching_m_s2": 4,
    },
    "pose_inverse_dynamics": {"law": "pose_inverse_dynamics", "wn_rad_s": 20},
}


def test_error_of_a_pd_by_a_force_is_that_of_its_springs():
    """Static: J^-T F / K_p; a loop without overshoot moves no further."""
    pd = {"controller": {"law": "pd_gravity", "kp_N_m": 4e4, "kv_N_s_m": 1.5e4}, **UNWATCHED}
    c = loads(with_changes(load("lab").text, pd), "pd")
    J = jacobian(build_platform(c.platform), *pose_arrays(c.platform.home))
    static_mm = 1e3 * 100.0 * np.linalg.norm(np.linalg.inv(J).T[:, :3], axis=1).max() / 4e4
    assert figures_of(c, delays_of(c), 100.0)["disturbed_error_mm"] == pytest.approx(static_mm, rel=0.1)


def test_gains_of_a_law_without_a_model_move_the_rotors_of_the_plant():
    lab: Any = load("lab")
    pd = {"controller": {"law": "pd", "kp_N_m": 2e5, "kv_N_s_m": 4e4}, **UNWATCHED}
    c: Any = with_gains(loads(with_changes(lab.text, pd), "pd"), 20.0, 1.0)
    platform, home = build_platform(lab.platform), pose_arrays(lab.platform.home)
    to_legs = np.linalg.inv(jacobian(platform, *home))
    M = Model(platform, reflected_mass=lab.plant.model.reflected_mass_kg).mass_matrix(*home)
    heaviest_kg = np.linalg.eigvalsh(to_legs.T @ M @ to_legs).max()
    assert c.controller.kp_N_m == pytest.approx(heaviest_kg * 20.0**2, rel=1e-3)


def test_stated_boundary_layer_becomes_thinner_with_a_faster_law():
    stated = OTHERS["sliding_mode"] | {"boundary_layer_m_s": 0.4}
    c = loads(with_changes(load("lab").text, {"controller": stated, **UNWATCHED}), "layer")
    law: Any = with_gains(c, 40.0, 1.0).controller
    assert (law.lambda_rad_s, law.boundary_layer_m_s) == (40.0, 0.2)


def test_tuned_gains_that_fault_on_the_path_are_no_success():
    tight = {"limits": {"following_error_m": 2e-4, "following_error_s": 1e-4}, **UNWATCHED}
    found = tune(loads(with_changes(load("lab").text, tight), "tight"))
    assert "FOLLOWING" in found["gains"]["tuned"]["fault"]
    assert not found["success"]


def test_uncoupled_legs_on_springs_are_refused():
    with pytest.raises(ConfigurationError, match="uncoupled legs"):
        tune(load("bench"))


def test_own_law_with_unknown_dynamics_is_refused_with_what_it_needs():
    class Own(LawSettings):
        knob = {"gain": 2}

    c = load("lab").model_copy(update={"controller": Own(law="own")})
    with pytest.raises(ConfigurationError, match="error_dynamics"):
        tune(c)


def test_law_with_fixed_gains_is_refused_and_refers_to_hil_design():
    fixed = {"controller": {"law": "state_space", "controller_file": "hinf"}, **UNWATCHED}
    with pytest.raises(ConfigurationError, match="fixed gains; see `hil design`"):
        tune(loads(with_changes(load("lab").text, fixed), "lab"))


def test_delay_margin_that_no_gains_have_is_refused():
    with pytest.raises(ConfigurationError, match="--delay-margin"):
        tune(load("lab"), delay_margin_ms=5000.0)


def test_command_prints_a_block_that_yaml_reads_and_writes_the_figures(tmp_path):
    done = CliRunner().invoke(main, ["tune", "ideal", "--json", str(tmp_path / "t.json")])
    assert done.exit_code == 0, done.output
    block = done.output[done.output.index("controller:") :]
    figures = json.loads((tmp_path / "t.json").read_text())
    assert yaml.safe_load(block) == figures["block"]
    assert figures["gains"]["tuned"]["crossover_rad_s"] < pi * 1000
