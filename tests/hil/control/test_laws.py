"""The contract that every control law keeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from hil.config.axis_model import AxisSpace
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.config.values import Pose
from hil.contracts.law import LawContract
from hil.contracts.records import arrived, asked
from hil.control import LAWS, ControllerSettings
from hil.control.cartesian_pd import CartesianPDSettings
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.law import LawContext
from hil.control.partial_linearisation import PartialLinearisationSettings
from hil.control.pd import PDSettings
from hil.control.pd_gravity import PDGravitySettings
from hil.control.pid import PIDSettings
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.control.state_space import StateSpaceSettings
from hil.control.uncertainty import UncertaintySettings
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian, leg_lengths
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample

BOOK = json.loads((Path(__file__).parents[2] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
UNCERTAINTY = UncertaintySettings(disturbance_m_s2=10.0)
SETTINGS: dict[str, ControllerSettings] = {
    "pd": PDSettings(law="pd", kp_N_m=2e6, kv_N_s_m=5e4),
    "pid": PIDSettings(law="pid", kp_N_m=2e6, kv_N_s_m=5e4, ki_N_m_s=1e7, integral_limit_N=5e3),
    "pd_gravity": PDGravitySettings(law="pd_gravity", kp_N_m=2e6, kv_N_s_m=5e4),
    "cartesian_pd": CartesianPDSettings(
        law="cartesian_pd",
        kp_position_N_m=1e6,
        kv_position_N_s_m=1e5,
        kp_rotation_N_m_rad=1e7,
        kv_rotation_N_m_s_rad=1e5,
    ),
    "feedforward_pd": FeedforwardPDSettings(law="feedforward_pd", kp_N_m=2e6, kv_N_s_m=5e4),
    "pose_inverse_dynamics": PoseInverseDynamicsSettings(law="pose_inverse_dynamics", wn_rad_s=20.0),
    "partial_linearisation": PartialLinearisationSettings(law="partial_linearisation", wn_rad_s=20.0),
    "inverse_dynamics": InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0),
    "inverse_dynamics, constant": InverseDynamicsSettings(
        law="inverse_dynamics",
        wn_rad_s=20.0,
        model=ModelSettings(variant="constant", frozen_at=Pose(position_m=(0, 0, 1))),
    ),
    "sliding_mode": SlidingModeSettings(
        law="sliding_mode", lambda_rad_s=60.0, uncertainty=UNCERTAINTY, reaching_m_s2=1.0
    ),
    "sliding_mode, switching": SlidingModeSettings(
        law="sliding_mode",
        lambda_rad_s=60.0,
        uncertainty=UNCERTAINTY,
        reaching_m_s2=1.0,
        boundary_layer_m_s=0.0,
    ),
    "robust_inverse_dynamics": RobustInverseDynamicsSettings(
        law="robust_inverse_dynamics", wn_rad_s=40.0, uncertainty=UNCERTAINTY, boundary_layer_m_s=0.2
    ),
    "robust_inverse_dynamics, switching": RobustInverseDynamicsSettings(
        law="robust_inverse_dynamics", wn_rad_s=40.0, uncertainty=UNCERTAINTY, boundary_layer_m_s=0.0
    ),
    "state_space": StateSpaceSettings(law="state_space", controller_file="pd_lag_integral.yaml"),
    "state_space, pose": StateSpaceSettings(law="state_space", controller_file="pd_lag_integral.yaml"),
}


def pd_lag_integral(axes: AxisSpace) -> LinearController:
    """400 e + 40 de through a lag of 5 ms, and 2000 times the integral of e, of which limits take 0.2 a tick."""
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
"""Laws whose effort without error is the inverse dynamics of an exact model."""
CONTEXT = LawContext(PLATFORM, "none", 1e-3, HoldTrajectory(np.array([0.0, 0.0, 1.0]), np.eye(3)))
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


def test_every_law_of_the_table_is_under_contract():
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


MAY_BE_ZERO = {"boundary_layer_m_s"}


def gains(name):
    """The positive numbers of a law: one for all, as the settings above give them."""
    given = SETTINGS[name].model_dump()
    return [
        key
        for key, value in given.items()
        if isinstance(value, float) and value > 0 and key not in MAY_BE_ZERO
    ]


@pytest.mark.parametrize(("name", "gain"), [(name, gain) for name in SETTINGS for gain in gains(name)])
def test_a_gain_is_positive_and_finite_for_all_legs_and_for_each(name, gain):
    good = SETTINGS[name].model_dump()
    for bad in (0.0, -1.0, float("inf"), float("nan")):
        for value in (bad, [1.0, 1.0, bad, 1.0, 1.0, 1.0], [1.0, 1.0, bad]):
            with pytest.raises(ValidationError, match=gain):
                type(SETTINGS[name]).model_validate(good | {gain: value})


NO_INVERSE = {"pd", "pid", "inverse_dynamics, constant"}
"""Laws without the inverse of a current J."""


@laws
def test_a_leg_of_length_zero_or_a_jacobian_of_zeros_gives_no_number(name):
    """J has no inverse then: nan, which safety turns into a latched fault."""
    law = make(name)
    p = PLATFORM.base_joints[0] - PLATFORM.platform_joints[0]
    there = {"p": p, "R": np.eye(3), "J": 0.0, "p_d": p, "R_d": np.eye(3)}
    tau = asked(law, on_reference(sample(BOOK["states"][0])), **there)
    assert np.isfinite(tau).all() == (name in NO_INVERSE)


STATIC_SHARE = dict.fromkeys(SETTINGS, 1.0) | {"pd": 0.0, "pid": 0.0, "cartesian_pd": 0.0}
"""How much of the static force a law feeds forward."""


@laws
def test_at_rest_without_error_a_law_is_its_feedforward_of_the_weight(name):
    """3618.6 N in each leg at the book's home, or nothing where a law knows no model."""
    home = BOOK["home_static"]
    tau = asked(make(name), on_reference(sample(home)))
    np.testing.assert_allclose(tau, STATIC_SHARE[name] * np.array(home["force"]), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("case", BOOK["states"], ids=lambda c: f"t={c['t']:.2f}")
def test_in_motion_without_error_a_law_with_the_whole_model_is_the_forces_of_the_book(case, name):
    """41 states of the book's trajectory; forces confirmed by an independent engine to 1.6e-11 N."""
    tau = asked(make(name), on_reference(sample(case)))
    np.testing.assert_allclose(tau, case["force"], rtol=0, atol=1e-8 * np.abs(case["force"]).max())


@laws
def test_a_load_that_is_known_is_taken_off_by_laws_with_a_whole_model_and_by_no_other(name):
    """J^T (tau without it - tau with it) = wrench, ON the platform; constant dynamics has J of its pose."""
    law, load = make(name), np.array([1e3, -2e3, 3e3, 100.0, 200.0, -300.0])
    tick = on_reference(sample(BOOK["states"][5]))
    less = asked(law, tick) - asked(law, tick, wrench=load)
    constant = name == "inverse_dynamics, constant"
    J = jacobian(PLATFORM, np.array([0.0, 0.0, 1.0]), np.eye(3)) if constant else tick["J"]
    np.testing.assert_allclose(J.T @ less, load if constant or name in EXACT else NONE, rtol=0, atol=1e-6)


def test_pd_feeds_the_acceleration_of_each_leg_forward_times_its_mass():
    settings = PDSettings(
        law="pd", kp_N_m=2e6, kv_N_s_m=5e4, feedforward_mass_kg=[100, 200, 300, 400, 500, 0]
    )
    law = settings.build(CONTEXT)
    tau = asked(law, on_reference(sample(BOOK["states"][0])), ddq_d=[1.0, -2.0, 3.0, 0.5, 0.0, 7.0])
    assert tau.tolist() == [100.0, -400.0, 900.0, 200.0, 0.0, 0.0]


def test_pd_without_error_is_zero_and_with_error_is_the_gains():
    law = make("pd")
    tick = on_reference(sample(BOOK["states"][0]))
    assert not asked(law, tick).any()
    e = np.array([1e-3, 0, -2e-3, 0, 0, 0])
    np.testing.assert_allclose(asked(law, tick, q=tick["q"] - e), 2e6 * e, atol=1e-6)
    np.testing.assert_allclose(asked(law, tick, dq=tick["dq"] - e), 5e4 * e, atol=1e-9)


def test_exact_inverse_dynamics_answers_an_error_with_the_reflected_inertia():
    """An error E in the lengths adds J^-T M J^-1 K_P E, and that inertia is symmetric and positive definite."""
    law = make("inverse_dynamics")
    tick = on_reference(sample(BOOK["states"][10]))
    base = asked(law, tick)
    inertia = np.column_stack([asked(law, tick, ddq_d=tick["ddq_d"] + d) - base for d in np.eye(6)])
    e = np.array([3e-3, -1e-3, 2e-3, 0, 1e-3, -4e-3])
    tau = asked(law, tick, q=tick["q"] - e) - base
    np.testing.assert_allclose(tau, inertia @ (400.0 * e), rtol=1e-7, atol=1e-6)
    assert (np.linalg.eigvalsh((inertia + inertia.T) / 2) > 0).all()
    np.testing.assert_allclose(inertia, inertia.T, rtol=1e-6, atol=1e-6 * np.abs(inertia).max())


def test_lengths_are_those_of_the_book():
    case = BOOK["states"][20]
    s = sample(case)
    np.testing.assert_allclose(leg_lengths(PLATFORM, s.p, s.R), case["length"], atol=1e-11)
