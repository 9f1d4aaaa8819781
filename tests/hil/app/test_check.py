"""`hil check`: figures against the book, and the first instant at which a path violates a limit."""

import functools
import json
import re
from math import pi
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect, stopping_distances_m
from hil.app.check.subject import looked_at
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.override import Override
from tests.broad import broad
from tests.hil.app.texts import VIRTUAL, edited

pytestmark = pytest.mark.usefixtures("unproven")
BOOK = json.loads((Path(__file__).parents[2] / "data/book_platform.json").read_text())
STATES = {
    key: np.array([s[key] for s in BOOK["states"]]) for key in ("t", "length", "rate", "force", "cond_J")
}


def loaded(*changes):
    return loads(edited(*changes), "my.yaml")


def test_check_prints_lengths_and_forces_of_the_textbook_path_as_published():
    figures = inspect(load("virtual")).figures
    home = BOOK["home_static"]
    assert figures["home"]["leg_lengths_m"] == pytest.approx(home["length"], abs=1e-9)
    assert figures["home"]["static_forces_N"] == pytest.approx(home["force"], rel=1e-9)
    reference = figures["reference"]
    # 41 samples of the source lie on the path; its extremes may lie between two of them.
    assert reference["length_min_m"] == pytest.approx(STATES["length"].min(), abs=1e-4)
    assert reference["length_max_m"] == pytest.approx(STATES["length"].max(), abs=1e-4)
    assert reference["force_max_N"] == pytest.approx(STATES["force"].max(), rel=1e-9)
    assert reference["force_min_N"] == pytest.approx(STATES["force"].min(), rel=1e-9)
    assert reference["rate_max_m_s"] == pytest.approx(np.abs(STATES["rate"]).max(), rel=5e-3)
    # path time slows down from 1 to 0 within 0.5 s: half of them at the top speed
    assert reference["controlled_stop_m"] == pytest.approx(0.25 * np.abs(STATES["rate"]).max(), rel=5e-3)
    assert reference["force_step_N"] == pytest.approx(
        np.abs(STATES["force"][0] - home["force"]).max(), rel=1e-6
    )
    # A bound: at most 6^(1/32) above the condition number.
    assert STATES["cond_J"].max() <= reference["condition_max"] <= 1.0594 * STATES["cond_J"].max()


BROKEN = [
    ("force_N: 25000 ", "force_N: 15000 ", "force above limits.force_N 15000", "force", 15000),
    ("speed_m_s: 2 ", "speed_m_s: 1 ", "rate above limits.speed_m_s 1", "rate", 1),
]


@pytest.mark.parametrize(("old", "new", "message", "column", "limit"), BROKEN)
def test_check_reports_when_the_textbook_path_first_exceeds_a_limit(old, new, message, column, limit):
    with pytest.raises(ConfigurationError) as caught:
        inspect(loaded((old, new)))
    (problem,) = [p for p in caught.value.problems if message in p]
    line = VIRTUAL[: VIRTUAL.index("\nreference:")].count("\n") + 2
    assert problem.startswith(f"my.yaml:{line}:1: reference: at t = ")
    t = float(re.findall(r"at t = ([\d.]+) s", problem)[0])
    beyond = STATES["t"][(np.abs(STATES[column]) > limit).any(axis=1)][0]
    assert beyond - 0.05 <= t <= beyond


SPIN = """reference:
  type: waypoints
  points:
    - {t_s: 0, position_m: [0, 0, 1]}
    - {t_s: 2, position_m: [0, 0, 1], rotation_vector_deg: [0, 0, 160]}
"""


def spinning(limits=()):
    """A turn of 160 deg about z: J of such a platform is singular at +-90 deg (Fichter 1986)."""
    first, last = VIRTUAL.index("\nreference:") + 1, VIRTUAL.index("\nlimits:") + 1
    text = VIRTUAL[:first] + SPIN + "\n" + VIRTUAL[last:]
    wide = ("length_min_m: 0.75", "length_min_m: 0.1"), ("length_max_m: 2.2", "length_max_m: 5")
    return loads(edited(*wide, *limits, base=text), "my.yaml")


def test_path_through_a_singularity_is_refused_at_the_first_instant():
    """det J of this platform changes its sign at a turn of 90 deg about z, where opposite legs cross."""
    with pytest.raises(ConfigurationError) as caught:
        inspect(spinning([("condition: 50 ", "condition: 1e30 ")]))
    (problem,) = [p for p in caught.value.problems if "the path goes through a singularity of J" in p]
    t = float(re.findall(r"at t = ([\d.]+) s", problem)[0])
    u = np.roots([6, -15, 10, 0, 0, -90 / 160])
    (expected,) = 2 * u[(np.abs(u.imag) < 1e-12) & (u.real > 0) & (u.real < 1)].real
    assert expected <= t <= expected + 1.1e-3


def test_path_is_refused_where_the_condition_of_J_exceeds_its_limit():
    with pytest.raises(ConfigurationError, match=r"condition of J above limits\.condition 50: 50\.\d"):
        inspect(spinning())


SWINGING = """  points:
    - {t_s: 0, position_m: [0, 0, 1]}
    - {t_s: 1, position_m: [0, 0, 1.1]}
    - {t_s: 4, position_m: [0, 0, 0.9]}
    - {t_s: 5, position_m: [0, 0, 1]}

limits:"""


def test_force_step_between_two_periods_of_a_repeated_path_is_found():
    """Acceleration 6 D/h^2 down at the end, up at the next start: twice the step from rest."""
    first, last = VIRTUAL.index("  points:"), VIRTUAL.index("limits:  ")
    text = VIRTUAL[:first] + SWINGING + VIRTUAL[last + len("limits:") :]
    steps = {
        periods: inspect(loads(text.replace("periods: 10", f"periods: {periods}"), "my.yaml")).figures[
            "reference"
        ]["force_step_N"]
        for periods in ("1", "2", "null")
    }
    assert steps["2"] == steps["null"]
    # At one pose the force is linear in the acceleration: +0.6 m/s^2 from rest at the start, -0.6 at the end.
    assert steps["2"] == pytest.approx(2 * steps["1"], rel=1e-3)
    limited = text.replace("force_step_N: 4000 ", f"force_step_N: {1.5 * steps['1']:.0f} ")
    inspect(loads(limited.replace("periods: 10", "periods: 1"), "my.yaml"))
    with pytest.raises(
        ConfigurationError, match=r"at t = 5\.000 s: leg \d: force changes by more than limits.f"
    ):
        inspect(loads(limited, "my.yaml"))


def test_csv_path_in_mm_is_reported_as_one_problem_with_advice_to_divide_by_1000(tmp_path):
    rows = [f"{t},0,0,{1000 + 10 * t},0,0,0" for t in (0, 1, 2)]
    (tmp_path / "path.csv").write_text("\n".join(["t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", *rows]))
    sampled = {"reference": {"type": "sampled", "path": "path.csv"}}
    c = loads(with_changes(load("ideal").text, sampled), "mine.yaml", tmp_path)
    with pytest.raises(ConfigurationError, match="in mm instead of m") as caught:
        inspect(c)
    (problem,) = caught.value.problems
    # legs of 1.5925 m at z = 1 stand 1.2394 m beside their base: at z = 1000 they are 1000 m long
    assert "leg 0 would be 1000 m long" in problem
    assert "Divide x_m, y_m and z_m by 1000" in problem


UNCERTAIN = "  uncertainty: {disturbance_m_s2: 13, model_error: 0.1, acceleration_m_s2: 12}\n"
SLIDING = "  law: sliding_mode\n  reaching_m_s2: 1\n" + UNCERTAIN
ROBUST = "  law: robust_inverse_dynamics\n  wn_rad_s: 60\n" + UNCERTAIN


@functools.cache
def with_law(law):
    """Report on a law."""
    changes = ("  law: inverse_dynamics\n", law), ("  wn_rad_s: 20\n", ""), ("  damping_ratio: 1\n", "")
    return inspect(loaded(*changes))


@pytest.mark.parametrize(
    ("law", "margin_deg"),
    broad(
        [
            # rho = sqrt(6) 14.2 / 0.9 = 38.65 m/s^2. 0.43 m/s: K_P 8993, K_D 209.9, 214.0 rad/s, 78.7 less 28.2 deg.
            (ROBUST + "  boundary_layer_m_s: 0.43\n", 50.5),
            # 0.1 m/s: K_P 26788, K_D 506.5, 509.2 rad/s, 84.1 less 67.0 deg.
            (ROBUST + "  boundary_layer_m_s: 0.1\n", 17.1),
            # A delay T of 2.296 ms costs 117.9 lambda T degrees of 76.35 where the layer is k / lambda.
            (SLIDING + "  lambda_rad_s: 92\n", 51.44),
            (SLIDING + "  lambda_rad_s: 175\n", 28.97),
        ],
        quick=1,
    ),
)
def test_phase_margin_of_a_robust_law_is_that_of_the_linear_law_in_its_boundary_layer(law, margin_deg):
    report = with_law(law)
    assert report.figures["controller"]["phase_margin_deg"] == pytest.approx(margin_deg, abs=0.06)
    assert any("phase margin" in w for w in report.warnings) == (margin_deg < 30)


def closing(seconds):
    return ("brake_close_s: 0.1 ", f"brake_close_s: {seconds} ")


@pytest.mark.parametrize(("closing_s", "leaves"), [(0.125, False), (0.135, True)])
def test_check_warns_if_a_leg_may_reach_its_hard_end_before_brakes_close_on_lost_commands(closing_s, leaves):
    """A leg of the falling platform accelerates by slightly more than 9.81 x 1 / 1.5925 = 6.2 m/s^2."""
    T, a = 0.01 + closing_s, 6.4
    q, dq = (np.array([state[key] for state in BOOK["states"]]) for key in ("length", "rate"))
    away = q + dq * T + a * T**2 / 2, q + dq * T - a * T**2 / 2
    assert (away[0].max() > 2.2 or away[1].min() < 0.75) == leaves
    assert ("engage.brake_close_s" in inspect(loaded(closing(closing_s))).codes) == leaves


def test_stopping_distance_includes_watchdog_and_brake_times():
    """The distance is v T + a T^2 / 2: its mean speed starts at the top speed and grows linearly with T."""
    text = load("virtual").text
    T = np.array([0.04, 0.06, 0.1])
    closes = [text.replace(closing(0)[0], f"brake_close_s: {t - 0.01:g} ") for t in T]
    mean = np.array([stopping_distances_m(loads(each))[0] for each in closes]) / T
    rise = np.diff(mean) / np.diff(T)
    assert rise[1] == pytest.approx(rise[0], rel=1e-9)
    assert 9.81 / 1.5925 < 2 * rise[0] < 1.1 * 9.81 / 1.5925
    assert mean[0] - rise[0] * T[0] == pytest.approx(1.129, abs=1e-3)


# -- what a hold, a start and a deceleration take, against rigid bodies


@pytest.fixture(scope="module")
def virtual():
    return looked_at(load("virtual"))


def test_leg_mass_is_the_mass_that_one_leg_moves_alone(virtual):
    """Largest 1 / (J M^-1 J^T)_ii of the legs at home, kg."""
    platform, home = build_platform(virtual.c.platform), virtual.c.platform.home
    p, R = np.array(home.position_m), np.eye(3)
    J = jacobian(platform, p, R)
    alone = 1.0 / np.diag(J @ np.linalg.solve(Model(platform).mass_matrix(p, R), J.T)).min()
    assert virtual.leg_mass_kg == pytest.approx(alone)


RATE_Hz = 1000.0


def stopped(c, model, trajectory, at_s, up=False):
    """Force (n, 6) and leg acceleration (n, 6) of the rigid body during a speed change."""
    override, period = Override(1.0 / RATE_Hz, c.engage.stop_s), 1.0 / RATE_Hz
    override.place(0, at_s) if up else override.settle(0, 1.0)
    if not up:
        override.record["s"] = at_s
    override.aim(0, 1.0 if up else 0.0)
    forces, rates, still = [], [], np.zeros(6)
    for tick in range(round(1.2 * c.engage.stop_s * RATE_Hz)):
        override.advance(tick)
        s = trajectory.sample(override.time(tick))
        sigma, dsigma = override.sigma, override.dsigma
        twist, dtwist = sigma * s.twist, sigma**2 * s.dtwist + dsigma * s.twist
        forces.append(model.inverse_dynamics(s.p, s.R, twist, dtwist, still))
        a, b = model.platform.base_joints, model.platform.platform_joints
        legs = s.p + b @ s.R.T - a
        n = legs / np.linalg.norm(legs, axis=1)[:, None]
        rates.append((n * (twist[:3] + np.cross(twist[3:], b @ s.R.T))).sum(axis=1))
    return np.array(forces), np.diff(rates, axis=0) / period


@pytest.mark.parametrize("up", [False, True])
def test_hold_and_start_on_a_path_stay_within_the_printed_force_and_acceleration_bounds(virtual, up):
    c, model, trajectory, w, said = virtual.c, virtual.model, virtual.trajectory, virtual.walk, virtual.slowed
    fastest = float(w.t[np.abs(w.dq).max(axis=1).argmax()])
    found = [stopped(c, model, trajectory, t, up) for t in (fastest - 0.25, fastest - 0.1, 3.0, 7.3, 12.1)]
    friction = said.force_N - max(np.abs(f).max() for f, _ in found)
    assert friction > 0.0
    assert max(np.abs(a).max() for _, a in found) < said.acceleration_m_s2
    steps = max(np.abs(np.diff(f, axis=0)).max() for f, _ in found)
    own = np.abs(np.diff(w.tau[1:-1], axis=0)).max()
    assert steps < own + said.step_N


# -- from motor to leg, and the fused pose, by hand

EFFICIENCY = [0.9, 0.85, 0.8, 0.9, 1, 0.7]
MIXED = {
    "lead_m": [0.1, 0.1, 0.16, 0.1, 0.12, 0.1],
    "pulley_radius_m": None,
    "gear_ratio": [1, 1.25, 2, 1, 1.5, 1],
    "sign": [1, -1, 1, -1, -1, 1],
    "efficiency": EFFICIENCY,
}


def mixed(**changes):
    return loads(with_changes(load("desktop").text, {"drives": {"transmission": MIXED} | changes}), "my.yaml")


def test_turns_speed_and_torque_of_each_transmission_agree_with_a_hand_calculation():
    """q = 0.325 m + s l n / N, F = s 2 pi N tau / l; stroke 0.25 to 0.40 m, 0.25 m/s, 300 N rated."""
    report = inspect(mixed())
    figures, home = report.figures["transmission"], report.figures["home"]["static_forces_N"]
    assert figures["m_per_turn"] == pytest.approx([0.1, -0.08, 0.08, -0.1, -0.08, 0.1])
    assert figures["turns_retracted"] == pytest.approx([-0.75, 0.9375, -0.9375, 0.75, 0.9375, -0.75])
    assert figures["turns_extended"] == pytest.approx([0.75, -0.9375, 0.9375, -0.75, -0.9375, 0.75])
    assert figures["rpm"] == pytest.approx([150, 187.5, 187.5, 150, 187.5, 150])
    held = [h * m / (2 * pi) for h, m in zip(home, figures["m_per_turn"], strict=True)]
    assert figures["holding_Nm"] == pytest.approx(held)
    rated = [
        300 * m / (2 * pi) / e for m, e in zip([0.1, 0.08, 0.08, 0.1, 0.08, 0.1], EFFICIENCY, strict=True)
    ]
    assert figures["rated_Nm"] == pytest.approx(rated)
    lines = report.sections["motor to leg"]
    (second,) = [line for line in lines if line.startswith("1 ")]
    assert second.split()[1:6] == ["-80", "+0.9375", "to", "-0.9375", "78.54"]


def test_torque_above_the_motor_limit_is_refused_with_the_leg_that_needs_most():
    """Only leg 5 loses 30 %: 300 N x 0.1 m / (2 pi x 0.7) = 6.82 N m; the DM4310 can send 10."""
    with pytest.raises(
        ConfigurationError, match=r"450 N need 10\.23 N m of the motor of leg 5 \(62\.83 N per N m"
    ):
        mixed(force_limit_N=450)


def test_standard_deviations_of_the_fused_pose_are_printed():
    changes = {"sensors": {"tracker": {}}, "estimation": {"pose": "fused"}}
    report = inspect(loads(with_changes(load("lab").text, changes), "my.yaml"))
    assert "unknown forces 60 N over 100 ms" in report.sections["fused pose, standard deviations"]
