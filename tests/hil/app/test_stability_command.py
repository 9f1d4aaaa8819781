"""`hil stability`: a verdict for every law, with its reason."""

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.app.check.command import inspect
from hil.app.configuration.configuration import load, loads
from hil.app.stability.axes import designed
from hil.app.stability.command import assess, judge
from hil.app.stability.subject import Stated, Subject
from hil.cli import main
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.control import LAWS
from hil.design.stability.disturbance import Load

CONSTANT = "  model: {variant: constant, frozen_at: {position_m: [0, 0, 1]}}\n"
DELAY = "  delay_compensation: {bus_ms: 0.5, drive_lag_ms: 0.8, hold_ms: 0.5}\n"
VIRTUAL_CONFIGURATION = load("virtual")
VIRTUAL = VIRTUAL_CONFIGURATION.text
LEGS = "  kp_N_m: 4e5\n  kv_N_s_m: 4e4\n"
POSE = (
    "  kp_position_N_m: 4e5\n  kv_position_N_s_m: 4e4\n  kp_rotation_N_m_rad: 2e5\n  kv_rotation_N_m_s_rad: 2e4\n"
    "  model: {variant: full}\n"
)
UNCERTAIN = "  uncertainty: {disturbance_m_s2: 13, model_error: 0.1, acceleration_m_s2: 12}\n"
SLIDING = f"  law: sliding_mode\n  lambda_rad_s: 92\n  reaching_m_s2: 1\n{UNCERTAIN}"


def bench(law, *, rest=False, rate=1000):
    a, b = VIRTUAL.index("\ncontroller:") + 1, VIRTUAL.index("\nengage:") + 1
    text = f"{VIRTUAL[:a]}controller:\n{law}\n{VIRTUAL[b:]}"
    if rest:
        a, b = text.index("\nreference:") + 1, text.index("\nlimits:") + 1
        hold = "reference:\n  type: hold\n  pose: {position_m: [0, 0, 1]}\n  duration_s: 1\n"
        text = f"{text[:a]}{hold}\n{text[b:]}"
    return loads(text.replace("rate_Hz: 1000\n", f"rate_Hz: {rate}\n"), "my.yaml", Path())


VERDICTS = [
    (f"  law: pd\n{LEGS}", True, "conditional", "a pose 9.14 mm of leg length off"),
    (f"  law: pd_gravity\n{LEGS}", True, "conditional", "the set-point is asymptotically stable"),
    (f"  law: pd_gravity\n{LEGS}", False, "conditional", "the set-point is asymptotically stable"),
    (f"  law: pd_gravity\n{LEGS}  model: {{inertia_scale: 0.9}}\n", True, "conditional", "0.906 mm"),
    (f"  law: feedforward_pd\n{LEGS}", True, "conditional", "the set-point is asymptotically stable"),
    (f"  law: cartesian_pd\n{POSE}", True, "conditional", "falls by t^T K_v t: the set-point is asymptotically stable"),
    (f"  law: cartesian_pd\n{POSE}  rotation_error: vector_difference\n", True, "conditional", "not symmetric"),
    (f"  law: pid\n{LEGS}  ki_N_m_s: 4e5\n  integral_limit_N: 1e4\n", True, "conditional", "die out as exp"),
    (f"  law: pid\n{LEGS}  ki_N_m_s: 4e5\n  integral_limit_N: 100\n", True, "not proven", "cannot carry the weight"),
    (f"  law: pid\n{LEGS}  ki_N_m_s: 4e8\n  integral_limit_N: 1e4\n", True, "unstable", "eigenvalue"),
    ("  law: pd\n  kp_N_m: 100\n  kv_N_s_m: 4e4\n", True, "not proven", "stiffen them"),
    ("  law: inverse_dynamics\n  wn_rad_s: 20\n", False, "conditional", "stay below 0.229 mm"),
    ("  law: inverse_dynamics\n  wn_rad_s: 20\n", True, "conditional", "stay below 0.00212 mm"),
    ("  law: inverse_dynamics\n  wn_rad_s: 500\n", False, "unstable", "1 ms from measurement to force"),
    (f"  law: inverse_dynamics\n  wn_rad_s: 20\n{CONSTANT}", False, "not proven", "a wrong inertia"),
    (f"  law: inverse_dynamics\n  wn_rad_s: 90\n{DELAY}", False, "conditional", "stay below 0.0141 mm"),
    (f"  law: inverse_dynamics\n  wn_rad_s: 90\n{DELAY}", True, "conditional", "stay below 0.0021 mm"),
    ("  law: pose_inverse_dynamics\n  wn_rad_s: 20\n", False, "conditional", "0.143 mm and 0.0087 deg"),
    ("  law: partial_linearisation\n  wn_rad_s: 20\n", False, "conditional", "stay below 0.387 mm"),
    pytest.param(SLIDING, False, "conditional", "stay below 2.85 mm", marks=pytest.mark.long),
    (f"{SLIDING}  boundary_layer_m_s: 0\n", False, "not proven", "chatters"),
    pytest.param(
        f"  law: robust_inverse_dynamics\n  wn_rad_s: 60\n  boundary_layer_m_s: 0.43\n{UNCERTAIN}",
        False, "conditional", "stay below 2.58 mm", marks=pytest.mark.long,
    ),
]  # fmt: skip


def test_stability_tests_cover_every_registered_control_law():
    """Designed controllers have their own test below."""
    judged = {re.search(r"law: (\w+)", str(row))[1] for row in map(repr, VERDICTS)}  # type: ignore[index]
    assert judged | {"state_space"} == set(LAWS)


@pytest.mark.parametrize(("law", "rest", "status", "because"), VERDICTS)
def test_stability_of_each_control_law_has_the_expected_result_and_reason(law, rest, status, because):
    verdict = judge(bench(law, rest=rest))
    assert verdict.status == status, verdict
    assert because in verdict.claim
    if not rest and "pd" in law:
        assert any("while it moves nothing is proven" in condition for condition in verdict.conditions)


def test_pd_on_uncoupled_200_kg_legs_is_stable_up_to_its_sampling_limit():
    """200 kg, pure damping, h = T kv / m, a period of delay, a hold: z^2 - z + h = 0, stable for h < 1."""
    text = load("bench").text.replace("force_bandwidth_Hz: 200", "force_bandwidth_Hz: 0")
    (kp,), (kv,) = (
        [line for line in text.splitlines() if line.startswith(f"  {key}: ")]
        for key in ("kp_N_m", "kv_N_s_m")
    )
    for h, status in ((0.95, "conditional"), (1.05, "unstable")):
        changed = text.replace(kp, "  kp_N_m: 1").replace(kv, f"  kv_N_s_m: {h * 200.0 * 1000.0}")
        assert judge(loads(changed, "bench.yaml", Path())).status == status


def test_sliding_mode_gain_too_small_for_the_stated_load_is_reported_as_not_proven():
    config = bench(SLIDING, rest=True)
    assert judge(config, Stated(Load(15_000.0), 0.1)).status == "conditional"
    verdict = judge(config, Stated(Load(30_000.0), 0.1))
    assert verdict.status == "not proven"
    assert "do not cover" in verdict.claim


def test_bound_of_a_pose_space_law_is_in_millimetres_and_degrees():
    """10 kN on 1150 kg and part of the legs: below 10 / 1150 of m/s^2 over wn^2, 21.7 mm, and the pushes."""
    law = "  law: pose_inverse_dynamics\n  wn_rad_s: 20\n"
    summary = assess(bench(law, rest=True), force_N=10_000.0)
    least = max(summary["figures"]["ultimate_bound"][:3])
    assert 0.7 * 10_000 / 1150 / 400 < least < 1.15 * 10_000 / 1150 / 400
    assert "mm and" in summary["claim"]


def test_stability_of_a_controller_file_with_pd_gains_equals_that_of_inverse_dynamics():
    controller = LinearController(
        kind="linear-controller", method="hinf", axes="joint", rate_Hz=1000, inputs=["error", "rate_error"],
        A=[], B=[], C=[[]], D=[[400.0, 40.0]], anti_windup=[], design={},
    )  # fmt: skip
    plain = bench("  law: inverse_dynamics\n  wn_rad_s: 20\n")
    verdict = designed(Subject(plain, Stated(Load(17_320.0))), controller, ModelSettings(), [])
    reference = judge(plain, Stated(Load(17_320.0)))
    assert verdict.figures["sampled"] == pytest.approx(reference.figures["sampled"], rel=1e-9)
    assert verdict.status == "conditional"
    assert verdict.figures["ultimate_bound"] == pytest.approx(reference.figures["ultimate_bound"], rel=1e-9)
    wild = controller.model_copy(update={"D": [[250_000.0, 1000.0]]})
    assert designed(Subject(plain, Stated()), wild, ModelSettings(), []).status == "unstable"


def test_uncompensated_friction_counts_as_a_disturbance():
    """The lab's drives have 250 N of Coulomb and 600 N s/m of viscous friction; its law models none."""
    verdict = judge(load("lab"))
    assert max(verdict.figures["disturbance"]) > 1.0
    assert "stay below" in verdict.claim


def test_check_prints_the_stability_result_and_warns_about_an_unstable_loop():
    report = inspect(load("virtual"))
    line = "stability conditional: errors stay below 0.229 mm of leg length along the reference"
    assert line in report.sections["controller"]
    assert report.figures["stability"]["status"] == "conditional"
    bad = inspect(bench("  law: inverse_dynamics\n  wn_rad_s: 500\n"))
    assert any("eigenvalue of magnitude" in w for w in bad.warnings)


def test_command_prints_bound_and_margins_and_writes_json(tmp_path):
    file = tmp_path / "proof.json"
    options = ["stability", "virtual", "--disturbance-force", "17320", "--json", str(file)]
    result = CliRunner().invoke(main, options)
    assert result.exit_code == 0, result.output
    text = " ".join(result.output.split())
    for words in ("status conditional", "mm of leg length", "margins phase 71 deg", "dV/dt <= -10 (V - d^2)"):
        assert words in text
    summary = json.loads(file.read_text())
    assert summary["kind"] == "stability"
    assert summary["stated"]["force_N"] == 17320
    assert len(summary["figures"]["ultimate_bound"]) == 6


def test_unstable_law_exits_with_1_and_invalid_option_with_2(tmp_path):
    config = tmp_path / "my.yaml"
    config.write_text(bench("  law: inverse_dynamics\n  wn_rad_s: 500\n").text)
    assert CliRunner().invoke(main, ["stability", str(config)]).exit_code == 1
    assert CliRunner().invoke(main, ["stability", "virtual", "--model-error", "1"]).exit_code == 2
    assert CliRunner().invoke(main, ["stability", "virtual", "--disturbance-force", "-1"]).exit_code == 2


@pytest.mark.parametrize(
    ("at", "alpha", "millimetres"), [("230kg@0,0,0", 0.441, 11.3), ("230@0.5,0.3,0.5", 0.571, 36.9)]
)
def test_stability_bound_includes_inertia_and_weight_of_an_unknown_payload(at, alpha, millimetres, tmp_path):
    """Its mass share of 0.17 is not enough: away from the centre it also turns the platform."""
    path = tmp_path / "proof.json"
    done = CliRunner().invoke(main, ["stability", "virtual", "--payload", at, "--json", str(path)])
    assert done.exit_code == 0, done.output
    summary = json.loads(path.read_text())
    assert summary["figures"]["alpha"] == pytest.approx(alpha, abs=1e-3)
    assert f"errors stay below {millimetres} mm" in summary["claim"]
    assert summary["stated"]["payload_kg"] == 230.0
    assert "230 kg at (0" in done.output


@pytest.mark.parametrize("belief", ["{inertia_scale: 0.9}", "{coulomb_friction_N: 100}"])
def test_constant_error_at_rest_is_not_reported_as_decaying(belief):
    """A wrong weight, or friction in the model of the law that the robot does not have."""
    found = judge(bench(f"  law: inverse_dynamics\n  wn_rad_s: 20\n  model: {belief}\n", rest=True))
    assert found.status == "conditional"
    assert "errors stay below" in found.claim
    assert "die out" not in found.claim


def test_stability_bound_includes_dry_friction_even_if_the_law_compensates_it():
    text = bench(
        "  law: inverse_dynamics\n  wn_rad_s: 20\n  model: {coulomb_friction_N: 250}\n", rest=True
    ).text
    c = loads(text.replace("coulomb_friction_N: 0\n", "coulomb_friction_N: 250\n"), "my.yaml", Path())
    found = judge(c)
    assert found.status == "conditional"
    assert found.figures["ultimate_bound"][0] > 3.5e-3, "250 N hold a leg against its spring of wn^2 m"


@pytest.mark.parametrize(
    "given", ["heavy", "-1kg", "230kg@0,0", "230kg@0,0,nan", "inf", "1e300", "230@0,1e300,0", ""]
)
def test_stability_refuses_an_invalid_payload(given):
    done = CliRunner().invoke(main, ["stability", "virtual", "--payload", given])
    assert done.exit_code == 2
    assert "allowed: a mass in kg and its place in m" in done.output
