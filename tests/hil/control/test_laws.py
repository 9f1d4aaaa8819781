"""All control laws: contract suite, weight, load and gains."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from hil.config.axis_model import AxisSpace
from hil.config.linear_controller import LinearController
from hil.contracts.law import LawContract
from hil.contracts.records import altered, arrived, asked
from hil.control import LAWS, ControllerSettings
from hil.control.law import DesiredLoop
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.kinematics import jacobian
from hil.trajectory.path import PoseSample
from tests.hil.control import legs

BOOK = legs.BOOK
PLATFORM = legs.PLATFORM
PD = {"kp_N_m": 2e6, "kv_N_s_m": 5e4}
PID = {**PD, "ki_N_m_s": 1e7, "integral_limit_N": 5e3}
POSE_PD = {
    "kp_position_N_m": 1e6,
    "kv_position_N_s_m": 1e5,
    "kp_rotation_N_m_rad": 1e7,
    "kv_rotation_N_m_s_rad": 1e5,
}
UNCERTAIN = {"uncertainty": {"disturbance_m_s2": 10.0}}
SLIDING = {"lambda_rad_s": 60.0, **UNCERTAIN, "reaching_m_s2": 1.0}
CONSTANT = {"variant": "constant", "frozen_at": {"position_m": (0, 0, 1)}}
GIVEN: dict[str, dict[str, Any]] = {
    "pd": PD,
    "pid": PID,
    "pd_gravity": PD,
    "cartesian_pd": POSE_PD,
    "feedforward_pd": PD,
    "pose_inverse_dynamics": {"wn_rad_s": 20.0},
    "partial_linearisation": {"wn_rad_s": 20.0},
    "inverse_dynamics": {"wn_rad_s": 20.0},
    "inverse_dynamics, constant": {"wn_rad_s": 20.0, "model": CONSTANT},
    "sliding_mode": SLIDING,
    "sliding_mode, switching": {**SLIDING, "boundary_layer_m_s": 0.0},
    "robust_inverse_dynamics": {"wn_rad_s": 40.0, **UNCERTAIN, "boundary_layer_m_s": 0.2},
    "robust_inverse_dynamics, switching": {"wn_rad_s": 40.0, **UNCERTAIN, "boundary_layer_m_s": 0.0},
    "state_space": {"controller_file": "pd_lag_integral.yaml"},
    "state_space, pose": {"controller_file": "pd_lag_integral.yaml"},
}


def settings_of(name, **changes):
    law = name.split(",")[0]
    return LAWS[law].model_validate({"law": law} | GIVEN[name] | changes)


SETTINGS: dict[str, ControllerSettings] = {name: settings_of(name) for name in GIVEN}


def pd_lag_integral(axes: AxisSpace) -> LinearController:
    """400 e + 40 de through a lag of 5 ms, plus 2000 times the integral of e with an anti-windup gain of 0.2 per tick."""
    a = float(np.exp(-0.2))
    return LinearController(
        kind="linear-controller",
        method="hinf",
        axes=axes,
        rate_Hz=1e3,
        inputs=["error", "rate_error"],
        A=[[a, 0.0], [0.0, 1.0]],
        B=[[400.0 * (1 - a), 40.0 * (1 - a)], [2.0, 0.0]],
        C=[[1.0, 1.0]],
        D=[[0.0, 0.0]],
        anti_windup=[0.0, 0.2],
        design={},
    )


CONTROLLERS = {"state_space": pd_lag_integral("joint"), "state_space, pose": pd_lag_integral("pose")}
EXACT = (
    "feedforward_pd",
    "pose_inverse_dynamics",
    "inverse_dynamics",
    "sliding_mode",
    "sliding_mode, switching",
    "robust_inverse_dynamics",
    "robust_inverse_dynamics, switching",
    "state_space",
    "state_space, pose",
)
"""Laws whose force at zero error is the inverse dynamics of an exact model."""
CONTEXT = legs.context_of()
NONE = np.zeros(6)
laws = pytest.mark.parametrize("name", SETTINGS)


def make(name):
    return SETTINGS[name].build(CONTEXT._replace(controller=CONTROLLERS.get(name)))


def sample(case):
    R = rotation_from_vector(np.array(case["rotvec"]))
    twist, dtwist = np.array(case["v"] + case["omega"]), np.array(case["a"] + case["alpha"])
    return PoseSample(np.array(case["p"]), R, twist, dtwist)


def on_reference(s):
    return arrived(PLATFORM, s)


def test_contract_test_suite_covers_every_registered_law():
    assert {n.split(",")[0] for n in SETTINGS} == set(LAWS)


@laws
class TestLaws(LawContract):
    @pytest.fixture
    def platform(self):
        return PLATFORM

    @pytest.fixture
    def samples(self):
        return [sample(case) for case in BOOK["states"]]

    @pytest.fixture
    def law(self, name):
        return make(name)


NO_INVERSE = {"pd", "pid", "inverse_dynamics, constant"}
"""Laws that do not invert the present J."""


@laws
def test_laws_that_invert_J_give_nan_at_a_singular_pose(name):
    """J is singular: the force is nan, which safety turns into a latched fault."""
    law = make(name)
    p = PLATFORM.base_joints[0] - PLATFORM.platform_joints[0]
    there = {"p": p, "R": np.eye(3), "J": 0.0, "p_d": p, "R_d": np.eye(3)}
    tau = asked(law, on_reference(sample(BOOK["states"][0])), **there)
    assert np.isfinite(tau).all() == (name in NO_INVERSE)


STATIC_SHARE = dict.fromkeys(SETTINGS, 1.0) | {"pd": 0.0, "pid": 0.0, "cartesian_pd": 0.0}
"""Share of the static force in a law's feed-forward."""


@laws
def test_at_rest_without_error_the_force_is_the_gravity_feedforward(name):
    """3618.6 N in each leg at the book's home; 0 for a law without a model."""
    home = BOOK["home_static"]
    tau = asked(make(name), on_reference(sample(home)))
    np.testing.assert_allclose(tau, STATIC_SHARE[name] * np.array(home["force"]), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("case", BOOK["states"], ids=lambda c: f"t={c['t']:.2f}")
def test_laws_with_an_exact_model_give_the_textbook_forces_at_zero_error(case, name):
    """41 states of the book's trajectory; forces confirmed by an independent engine to 1.6e-11 N."""
    tau = asked(make(name), on_reference(sample(case)))
    np.testing.assert_allclose(tau, case["force"], rtol=0, atol=1e-8 * np.abs(case["force"]).max())


@laws
def test_only_laws_with_an_exact_model_compensate_a_known_load(name):
    """J^T (tau without load - tau with load) = wrench ON the platform; the constant model has a frozen J."""
    law, load = make(name), np.array([1e3, -2e3, 3e3, 100.0, 200.0, -300.0])
    tick = on_reference(sample(BOOK["states"][5]))
    less = asked(law, tick) - asked(law, tick, wrench=load)
    constant = name == "inverse_dynamics, constant"
    J = jacobian(PLATFORM, np.array([0.0, 0.0, 1.0]), np.eye(3)) if constant else tick["J"]
    np.testing.assert_allclose(J.T @ less, load if constant or name in EXACT else NONE, rtol=0, atol=1e-6)


def test_feedforward_force_of_pd_is_mass_times_acceleration_of_each_leg():
    law = settings_of("pd", feedforward_mass_kg=[100, 200, 300, 400, 500, 0]).build(CONTEXT)
    tau = asked(law, on_reference(sample(BOOK["states"][0])), ddq_d=[1.0, -2.0, 3.0, 0.5, 0.0, 7.0])
    assert tau.tolist() == [100.0, -400.0, 900.0, 200.0, 0.0, 0.0]


def test_pd_force_is_zero_without_error_and_gain_times_error_otherwise():
    law = make("pd")
    tick = on_reference(sample(BOOK["states"][0]))
    assert not asked(law, tick).any()
    e = np.array([1e-3, 0, -2e-3, 0, 0, 0])
    np.testing.assert_allclose(asked(law, tick, q=tick["q"] - e), 2e6 * e, atol=1e-6)
    np.testing.assert_allclose(asked(law, tick, dq=tick["dq"] - e), 5e4 * e, atol=1e-9)


def test_inverse_dynamics_scales_an_error_by_the_leg_space_inertia():
    """A length error E adds J^-T M J^-1 K_P E; this leg-space inertia is symmetric and positive definite."""
    law = make("inverse_dynamics")
    tick = on_reference(sample(BOOK["states"][10]))
    base = asked(law, tick)
    inertia = np.column_stack([asked(law, tick, ddq_d=tick["ddq_d"] + d) - base for d in np.eye(6)])
    e = np.array([3e-3, -1e-3, 2e-3, 0, 1e-3, -4e-3])
    tau = asked(law, tick, q=tick["q"] - e) - base
    np.testing.assert_allclose(tau, inertia @ (400.0 * e), rtol=1e-7, atol=1e-6)
    assert (np.linalg.eigvalsh((inertia + inertia.T) / 2) > 0).all()
    np.testing.assert_allclose(inertia, inertia.T, rtol=1e-6, atol=1e-6 * np.abs(inertia).max())


BAD_GAINS = [
    (name, key)
    for name, given in GIVEN.items()
    for key, value in given.items()
    if isinstance(value, float) and value > 0 and key != "boundary_layer_m_s"
]


@pytest.mark.parametrize(("name", "gain"), BAD_GAINS)
def test_gains_that_are_not_positive_and_finite_are_refused(name, gain):
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        for value in (bad, [1.0, 1.0, bad, 1.0, 1.0, 1.0], [1.0, 1.0, bad]):
            with pytest.raises(ValidationError, match=gain):
                settings_of(name, **{gain: value})


TOO_UNSURE = {"disturbance_m_s2": 1.0, "model_error": 1.0, "acceleration_m_s2": 1.0}


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("sliding_mode", {"boundary_layer_m_s": -0.1}, "boundary_layer_m_s"),
        ("robust_inverse_dynamics", {"boundary_layer_m_s": -0.1}, "boundary_layer_m_s"),
        ("robust_inverse_dynamics", {"damping_ratio": -1.0}, "damping_ratio"),
        ("sliding_mode", {"uncertainty": TOO_UNSURE}, "model_error"),
        ("sliding_mode", {"uncertainty": {"disturbance_m_s2": 1.0, "model_error": 0.1}}, "acceleration_m_s2"),
        ("sliding_mode", {"uncertainty": {"disturbance_m_s2": 0.0}}, "uncertainty is zero"),
        ("partial_linearisation", {"model": {"variant": "full"}}, "variant"),
        ("state_space", {"delay_compensation": {"bus_ms": 1.0}}, "delay"),
    ],
)
def test_invalid_settings_of_a_law_are_refused_with_their_key(name, changes, words):
    with pytest.raises(ValidationError, match=words):
        settings_of(name, **changes)


# -- gains for each leg, and gains for a bandwidth -----------------------------------------------------------

SIX = np.array([1.0, 1.7, 0.6, 2.3, 0.8, 1.2])
FED = {"feedforward_mass_kg": 300.0}
PER_LEG: dict[str, dict[str, Any]] = {
    "pd": PD | FED, "pid": PID | FED | {"integral_limit_N": 60.0}, "pd_gravity": PD, "feedforward_pd": PD,
}  # fmt: skip
ERRORS = np.random.default_rng(5).uniform(-1e-3, 1e-3, (10, 3, 6)) + np.array([2e-3, 0.0, 0.0])[:, None]
"""Errors of lengths and rates, and accelerations, tick by tick; the integral reaches its limit."""


def forces(law, gains, side):
    made = settings_of(law, **gains).build(CONTEXT)
    still = on_reference(sample(BOOK["home_static"]))
    found = []
    for e, de, ddq_d in side * ERRORS:
        tick = altered(still, q=still["q"] - e, dq=still["dq"] - 10.0 * de, ddq_d=1e3 * ddq_d)
        found.append(asked(made, tick))
    return np.array(found)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("law", "gain"), [(law, gain) for law, gains in PER_LEG.items() for gain in gains])
def test_law_accepts_one_gain_per_leg(law, gain, side):
    gains = PER_LEG[law]
    together = forces(law, gains | {gain: (gains[gain] * SIX).tolist()}, side)
    alone = [forces(law, gains | {gain: gains[gain] * share}, side)[:, leg] for leg, share in enumerate(SIX)]
    np.testing.assert_allclose(together, np.transpose(alone), rtol=1e-12)
    differs = np.abs(together - forces(law, gains, side)).max(axis=0)
    assert differs[SIX != 1.0].min() > 1.0, "each gain counts"


LOOP = DesiredLoop(wn=40.0, zeta=0.7, leg_mass=300.0, mass=1200.0, inertia=500.0, force_limit=9000.0)
OF_LEGS = [("kp_N_m", "kv_N_s_m", 300.0)]
OF_THE_POSE = [
    ("kp_position_N_m", "kv_position_N_s_m", 1200.0),
    ("kp_rotation_N_m_rad", "kv_rotation_N_m_s_rad", 500.0),
]


@pytest.mark.parametrize(
    ("law", "motions"), [("pd", OF_LEGS), ("pid", OF_LEGS), ("cartesian_pd", OF_THE_POSE)]
)
def test_default_gains_give_the_requested_frequency_and_damping(law, motions):
    """Roots of m s^2 + K_v s + K_p."""
    gains = LAWS[law].derived(LOOP)
    for stiffness, damping, inertia in motions:
        roots = np.roots([inertia, gains[damping], gains[stiffness]])
        np.testing.assert_allclose(np.abs(roots), LOOP.wn, rtol=1e-9)
        np.testing.assert_allclose(-roots.real, LOOP.zeta * LOOP.wn, rtol=1e-9)
    settings = settings_of(law, **gains)
    assert settings.bandwidth(LOOP.leg_mass, LOOP.mass) == pytest.approx((LOOP.wn, LOOP.zeta))


def test_default_integral_gain_is_a_tenth_of_the_stability_limit():
    """m s^3 + K_v s^2 + K_p s + 10 K_i has roots on the imaginary axis, at the loop's natural frequency."""
    gains = LAWS["pid"].derived(LOOP)
    assert gains["integral_limit_N"] == LOOP.force_limit
    roots = np.roots([LOOP.leg_mass, gains["kv_N_s_m"], gains["kp_N_m"], 10.0 * gains["ki_N_m_s"]])
    swinging = roots[np.abs(roots.imag) > 1.0]
    assert len(swinging) == 2
    np.testing.assert_allclose(swinging.real, 0.0, atol=1e-6 * LOOP.wn)
    np.testing.assert_allclose(np.abs(swinging), LOOP.wn, rtol=1e-9)
