"""The law that runs a designed controller: known answers, SciPy's recursion, and anti-windup."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import dlsim

from drivers.errors import ConfigurationError
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.config.values import Pose
from hil.contracts.records import arrived, asked
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.control.state_space import StateSpaceSettings
from hil.loop.reference import fill_reference
from hil.mathematics.rotations import rotation_from_vector
from hil.trajectory.path import PoseSample
from tests.hil.control.legs import BOOK, CONTEXT, NONE, PLATFORM, at_rest

CASE = BOOK["states"][7]
PUSH = np.array([1e3, -2e3, 500.0, 0.0, 3e3, -700.0])


def controller(A, B, C, D, anti_windup=None, *, axes="joint", inputs=("error", "rate_error"), rate_Hz=1e3):
    return LinearController(
        kind="linear-controller",
        method="mu",
        axes=axes,
        rate_Hz=rate_Hz,
        inputs=list(inputs),
        A=A,
        B=B,
        C=C,
        D=D,
        anti_windup=[0.0] * len(A) if anti_windup is None else anti_windup,
        design={},
    )


def law(given, model=None):
    settings = StateSpaceSettings(law="state_space", controller_file="x.yaml", model=model or ModelSettings())
    return settings.build(CONTEXT._replace(controller=given))


def astray():
    """The platform near the book's path: 1 cm, 6 degrees and some speed away from its reference."""
    R = rotation_from_vector(np.array(CASE["rotvec"]))
    twist, dtwist = np.array(CASE["v"] + CASE["omega"]), np.array(CASE["a"] + CASE["alpha"])
    p_d, R_d = np.array(CASE["p"]), R
    p, R = p_d + 0.01, R @ rotation_from_vector(np.array([0.1, 0.02, -0.03]))
    there = arrived(PLATFORM, PoseSample(p, R, twist + 0.1, NONE))
    fill_reference(PLATFORM, PoseSample(p_d, R_d, twist, dtwist), there)
    return there


STILL = controller([], [], [[]], [[0.0, 0.0]])

MODELS = {
    "full": ModelSettings(),
    "x 0.9": ModelSettings(inertia_scale=0.9, reflected_mass_kg=30.0),
    "constant": ModelSettings(variant="constant", frozen_at=Pose(position_m=(0, 0, 1))),
    "constant_MG": ModelSettings(variant="constant_MG", frozen_at=Pose(position_m=(0, 0, 1))),
}
models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@models
@pytest.mark.parametrize(
    ("axes", "settings"),
    [
        ("joint", InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0)),
        ("pose", PoseInverseDynamicsSettings(law="pose_inverse_dynamics", wn_rad_s=20.0)),
    ],
)
def test_a_static_controller_is_inverse_dynamics_with_its_gains(axes, settings, model):
    """u = wn^2 e + 2 wn de, a controller without states."""
    given = controller([], [], [[]], [[400.0, 40.0]], axes=axes)
    expected = asked(settings.model_copy(update={"model": model}).build(CONTEXT), astray())
    np.testing.assert_allclose(asked(law(given, model), astray()), expected, rtol=1e-12)


def test_controller_output_matches_scipys_recursion():
    """SciPy's dlsim, with a different error for each leg and one controller."""
    random = np.random.default_rng(5)
    A = random.normal(size=(5, 5))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = random.normal(size=(5, 2)), random.normal(size=(1, 5)), np.array([[30.0, 4.0]])
    mine = law(controller(A.tolist(), B.tolist(), C.tolist(), D.tolist()))
    E, dE = random.normal(0, 1e-3, (12, 6)), random.normal(0, 1e-2, (12, 6))
    demands = np.array([demanded(mine, e, de) for e, de in zip(E, dE, strict=True)])
    for leg in range(6):
        _, u, _ = dlsim((A, B, C, D, 1e-3), np.column_stack([E[:, leg], dE[:, leg]]))
        np.testing.assert_allclose(demands[:, leg], u[:, 0], rtol=0, atol=1e-8 * np.abs(u).max())
    mine.reset()
    np.testing.assert_allclose(demanded(mine, E[0], dE[0]), demands[0], rtol=1e-12)


def demanded(mine, e, de, **columns):
    """u (6,) of one call, computed from the forces."""
    tick, inertia = at_rest(e, de)
    return np.linalg.solve(inertia, asked(mine, tick, **columns) - asked(law(STILL), tick))


@pytest.mark.parametrize(
    ("inputs", "expected"),
    [(["error"], [3.0, 0.0]), (["rate_error"], [0.0, 3.0]), (["rate_error", "error"], [5.0, 3.0])],
)
def test_controller_inputs_follow_the_order_in_the_file(inputs, expected):
    """u = 3 times the first input plus 5 times the second."""
    mine = law(controller([], [], [[]], [[3.0, 5.0][: len(inputs)]], inputs=inputs))
    e, de = np.full(6, 2e-3), np.full(6, -7e-3)
    u = expected[0] * e + expected[1] * de
    np.testing.assert_allclose(demanded(mine, e, de), u, rtol=1e-9)


# -- what limits take ----------------------------------------------------------------------------------------


@models
@pytest.mark.parametrize("axes", ["joint", "pose"])
def test_anti_windup_converts_the_force_shortfall_by_the_inverse_of_the_law(axes, model):
    """u = x = a: the law requests the acceleration of the missing force, and so exactly this force."""
    given = controller([[0.0]], [[0.0, 0.0]], [[1.0]], [[0.0, 0.0]], [1.0], axes=axes)
    whole = asked(law(given, model), astray())
    np.testing.assert_allclose(asked(law(given, model), astray(), shortfall=PUSH) - whole, PUSH, atol=1e-6)


def test_anti_windup_adds_gain_times_the_acceleration_shortfall_to_the_state():
    """x' = 0.5 x + 2 a and u = x: a shortfall of 1 m/s^2 on every leg reduces u by 2 m/s^2."""
    mine = law(controller([[0.5]], [[0.0, 0.0]], [[1.0]], [[0.0, 0.0]], [2.0]))
    inertia = at_rest(NONE, NONE)[1]
    for missing, u in ((-1.0, -2.0), (0.0, -1.0)):
        found = demanded(mine, NONE, NONE, shortfall=inertia @ np.full(6, missing))
        np.testing.assert_allclose(found, np.full(6, u), rtol=1e-9)


def test_a_controller_sampled_for_another_rate_is_refused():
    with pytest.raises(ConfigurationError, match="designed for 500 Hz"):
        law(controller([], [], [[]], [[1.0, 1.0]], rate_Hz=500.0))
