"""`hil compare --equal-crossover`: crossovers of the loops that run, and gains scaled to one of them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.cli import main
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.study.compare.crossover import equal_crossover, loop_of, scaled
from hil.study.compare.laws import changed, chosen

CONFIGS = Path(__file__).parents[3] / "configs"
WN = 20.0
VIRTUAL, IDEAL = load("virtual"), load("ideal")
crossovers: Any = equal_crossover


PD_CROSSOVER = np.sqrt(2.0 + np.sqrt(5.0))
"""Crossover by natural frequency of critically damped PD on 1/s^2: |(2 j w + 1) / w^2| = 1."""


def test_gains_of_all_laws_are_scaled_to_the_crossover_of_the_first_law():
    """PD on legs: |K_p + j w K_v| = m w^2 with the lightest motion's m, the least eigenvalue of J^-T M J^-1."""
    laws: dict[str, Any] = chosen(IDEAL, ["pd_gravity", "inverse_dynamics", "pose_inverse_dynamics", "pid"])
    laws["pose_inverse_dynamics"] = changed(laws["pose_inverse_dynamics"], {"wn_rad_s": [90.0] * 6})
    w_c, found, missed = crossovers(IDEAL, laws)
    p, R = np.array([0.0, 0.0, 1.0]), np.eye(3)
    platform = build_platform(IDEAL.platform)
    J = jacobian(platform, p, R)
    m = 1.0 / np.linalg.eigvals(J @ np.linalg.solve(Model(platform).mass_matrix(p, R), J.T)).real.max()
    a, b = laws["pd_gravity"].kv_N_s_m / m, laws["pd_gravity"].kp_N_m / m
    assert w_c == pytest.approx(np.sqrt((a**2 + np.sqrt(a**4 + 4 * b**2)) / 2), rel=0.01)
    assert not missed
    wn = w_c / PD_CROSSOVER
    assert found["inverse_dynamics"].wn_rad_s == pytest.approx(wn, rel=0.01)
    assert found["pose_inverse_dynamics"].wn_rad_s == pytest.approx([wn] * 6, rel=0.01)
    for name, law in found.items():
        assert loop_of(IDEAL, law).crossover_rad_s == pytest.approx(w_c, rel=1e-3), name


def test_gains_scaled_to_a_crossover_keep_the_shape_of_the_loop():
    """All poles of m s^3 + K_v s^2 + K_p s + K_i are multiplied by the factor."""
    before: Any = chosen(VIRTUAL, ["pid"])["pid"]
    after: Any = scaled(before, 0.3)
    poles = [np.roots([1e3, law.kv_N_s_m, law.kp_N_m, law.ki_N_m_s]) for law in (before, after)]
    assert np.allclose(0.3 * poles[0], poles[1])


def test_law_that_cannot_reach_the_common_crossover_stays_unchanged_and_is_reported():
    """Weight on legs is a negative stiffness: PD on legs that crosses over at 41 rad/s falls over."""
    laws = chosen(VIRTUAL, ["inverse_dynamics", "pd"])
    _, found, missed = crossovers(VIRTUAL, laws)
    assert found["pd"] == laws["pd"]
    assert list(missed) == ["pd"]


def test_a_law_with_fixed_gains_determines_the_crossover():
    design = yaml.safe_load((CONFIGS / "controllers/hinf.yaml").read_text())["design"]
    laws = chosen(VIRTUAL, ["inverse_dynamics", "sliding_mode", "state_space"])
    w_c, found, _ = crossovers(VIRTUAL, laws)
    assert w_c == pytest.approx(design["crossover_rad_s"], rel=1e-3)
    assert found["inverse_dynamics"].wn_rad_s * PD_CROSSOVER == pytest.approx(w_c, rel=0.03)
    assert found["sliding_mode"].lambda_rad_s == pytest.approx(found["inverse_dynamics"].wn_rad_s, rel=1e-3)


def test_the_wrench_observer_counts_in_the_crossover():
    """An observer adds 2 pi f (K_D + K_P / s) to the loop: the same crossover needs lower gains."""
    observing = changed(
        VIRTUAL, {"estimation.wrench.source": "observer", "estimation.wrench.bandwidth_Hz": 5.0}
    )
    laws = chosen(VIRTUAL, ["partial_linearisation", "inverse_dynamics"])
    w_c, found, _ = crossovers(observing, laws)
    assert w_c == pytest.approx(PD_CROSSOVER * WN, rel=1e-2)
    assert found["inverse_dynamics"].wn_rad_s < 0.7 * WN


def test_equal_crossover_prints_crossovers_and_gains(tmp_path):
    figures = ("--laws", "state_space,inverse_dynamics", "--paths", "none", "--duration", 0.2, "--jobs", 1)
    files = ("--picture", tmp_path, "--json", tmp_path / "a.json")
    arguments = ("compare", "virtual", *figures, "--equal-crossover", *files)
    done = CliRunner().invoke(main, [str(one) for one in arguments])
    assert done.exit_code == 0, done.output
    laws = json.loads((tmp_path / "a.json").read_text())["laws"]
    assert laws["inverse_dynamics"]["crossover_rad_s"] == pytest.approx(246.5, abs=0.5)
    wn = laws["inverse_dynamics"]["settings"]["wn_rad_s"]
    assert f"wn_rad_s {wn:.4g}" in done.output
    assert 2.5 < laws["inverse_dynamics"]["delay_margin_ms"] < 3.5
    assert laws["inverse_dynamics"]["rise_ms"] < 50.0, "the scaled gains ran: 168 ms at 20 rad/s"
