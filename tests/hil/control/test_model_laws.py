"""Laws that use parts of the model, against the forces, weights and Jacobians of the rigid-body engines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.model import ModelSettings
from hil.config.values import Pose
from hil.contracts.records import altered, arrived, asked, referred
from hil.control import LAWS
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.model import build_model
from hil.robot.geometry import Platform
from hil.trajectory.path import PoseSample
from tests.hil.control.legs import BOOK, HOME, PLATFORM, TRUTH, cases, close, context_of, engines

K_P = np.array([1e6, 2e6, 3e6, 4e5, 5e5, 6e5])
K_V = np.array([1e5, 2e5, 3e5, 4e4, 5e4, 6e4])
GAINS = {
    "kp_position_N_m": K_P[:3].tolist(),
    "kv_position_N_s_m": K_V[:3].tolist(),
    "kp_rotation_N_m_rad": K_P[3:].tolist(),
    "kv_rotation_N_m_s_rad": K_V[3:].tolist(),
}
PD = {"kp_N_m": 2e6, "kv_N_s_m": 5e4}
NONE = np.zeros(6)


def law_of(name, platform, **given):
    return LAWS[name].model_validate({"law": name} | given).build(context_of(platform))


@pytest.mark.parametrize("model", [None, {}], ids=["", "gravity"])
@cases(4)
def test_cartesian_pd_leg_forces_produce_the_wrench_of_the_pose_error(case, model):
    """J^T tau = K_p [p_d - p; rotation vector of R_d R^T] + K_v (twist_d - twist) + G, for turns up to 170 degrees."""
    random = np.random.default_rng(5)
    platform, state, _ = engines(case)
    p, R, twist = state["p"], state["R"], state["twist"]
    for angle in (0.0, 1e-9, 0.3, np.radians(170)):
        axis = random.normal(size=3)
        turn = angle * axis / np.linalg.norm(axis)
        R_d = np.ascontiguousarray((Rotation.from_rotvec(turn) * Rotation.from_matrix(R)).as_matrix())
        p_d, twist_d = p + random.normal(0, 0.1, 3), random.normal(0, 1, 6)
        law = law_of("cartesian_pd", platform, **GAINS, model=model)
        tau = asked(law, referred(platform, PoseSample(p_d, R_d, twist_d, NONE), **state))
        wrench = K_P * np.concatenate([p_d - p, turn]) + K_V * (twist_d - twist)
        if model is not None:
            wrench = wrench + case["expected"]["G"]
        close(state["J"].T @ tau, wrench)


@cases(8)
def test_rotation_error_can_be_the_difference_of_rotation_vectors(case):
    platform, state, _ = engines(case)
    phi_d = np.array([0.3, -0.2, 0.4])
    R_d = np.ascontiguousarray(Rotation.from_rotvec(phi_d).as_matrix())
    tick = referred(platform, PoseSample(state["p"], R_d, NONE, NONE), **(state | {"twist": NONE}))
    law = law_of("cartesian_pd", platform, **GAINS, rotation_error="vector_difference")
    difference = phi_d - Rotation.from_matrix(state["R"]).as_rotvec()
    close(state["J"].T @ asked(law, tick), K_P * np.concatenate([np.zeros(3), difference]))


@cases(3)
def test_pd_gravity_compensates_the_weight_of_a_reference_engine_at_the_measured_pose(case):
    platform, state, sample = engines(case)
    ahead = PoseSample(sample.p + 0.01, sample.R, NONE, np.ones(6))
    tick = referred(platform, ahead, **state)
    weight = np.linalg.solve(state["J"].T, case["expected"]["G"])
    expected = 2e6 * (tick["q_d"] - state["q"]) - 5e4 * state["dq"] + weight
    close(asked(law_of("pd_gravity", platform, **PD), tick), expected)


@cases(1)
def test_partial_linearisation_uses_inertia_and_gravity_but_no_coriolis_force_or_load(case):
    """ddq_d - (dJ/dt) twist = J dtwist on the reference; an error E adds J^-T M J^-1 (K_P E + K_D dE)."""
    platform, state, sample = engines(case)
    M, G, J = np.array(case["expected"]["M"]), np.array(case["expected"]["G"]), state["J"]
    E, dE = np.array([1e-3, 0, -2e-3, 0, 3e-3, 0]), np.array([0, 1e-2, 0, 0, -2e-2, 0])
    off = state | {"q": state["q"] - E, "dq": state["dq"] - dE, "wrench": case["state"]["wrench"]}
    law = law_of("partial_linearisation", platform, wn_rad_s=20.0, damping_ratio=0.5)
    correction = np.linalg.solve(J, 400.0 * E + 20.0 * dE)
    expected = np.linalg.solve(J.T, M @ (sample.dtwist + correction) + G)
    close(asked(law, referred(platform, sample, **off)), expected, 1e-8)


@cases(4)
def test_feedforward_force_equals_that_of_a_reference_engine_minus_the_load(case):
    platform, _, sample = engines(case)
    astray = {
        "p": np.array([0.0, 0.0, 1.0]),
        "R": np.eye(3),
        "J": np.eye(6),
        "wrench": case["state"]["wrench"],
    }
    gone = referred(platform, sample, **astray)
    gone["q"], gone["dq"] = gone["q_d"] - 1e-3, gone["dq_d"] + 2e-2
    expected = np.array(case["expected"]["leg_forces"]) + 2e6 * 1e-3 - 5e4 * 2e-2
    close(asked(law_of("feedforward_pd", platform, **PD), gone), expected, 2e-9)


def test_inertia_scale_scales_the_feedforward_of_massless_legs():
    """With massless legs every force is proportional to the platform's mass, its inertia and com."""
    light = {
        half: BOOK["geometry"][half] | {"mass": 0, "inertia_transverse": 0} for half in ("cylinder", "rod")
    }
    platform = Platform.from_dict(BOOK["geometry"] | light)
    tick = arrived(PLATFORM, PoseSample(*HOME, np.full(6, 0.2), np.ones(6)))
    full, less = (
        asked(law_of("feedforward_pd", platform, **PD, model={"inertia_scale": k}), tick) for k in (1.0, 0.9)
    )
    np.testing.assert_allclose(less, 0.9 * full, rtol=1e-9)


def test_every_key_of_section_model_is_passed_to_the_laws_model_in_SI_units():
    case = next(c for c in TRUTH["cases"] if np.abs(c["state"]["omega"]).min() > 0)
    platform, state, sample = engines(case)
    p, R, J = sample.p, sample.R, state["J"]
    M, G = np.array(case["expected"]["M"]), np.array(case["expected"]["G"])

    def model(**given):
        return build_model(ModelSettings(**given), platform, "none")

    close(model(reflected_mass_kg=[1, 2, 3, 4, 5, 6]).mass_matrix(p, R), M + J.T @ np.diag(range(1, 7)) @ J)
    close(model(inertia_scale=0.9).mass_matrix(p, R)[:3, :3], 0.9 * M[:3, :3])
    rubbing = model(
        viscous_friction_N_s_m=[10, 20, 30, 40, 50, 60], coulomb_friction_N=200, sliding_speed_m_s=0.01
    )
    friction = rubbing.friction(np.array([0.005, -0.005, 0.01, -0.02, 0.0, 1.0]))
    assert friction == pytest.approx([100.05, -100.1, 200.3, -200.8, 0.0, 260.0])
    turn = Rotation.from_matrix(R).as_rotvec(degrees=True)
    frozen = model(variant="constant", frozen_at=Pose(position_m=tuple(p), rotation_vector_deg=tuple(turn)))
    a = np.array([1.0, -2.0, 0.5, 0.3, -0.2, 0.1])
    close(frozen.inverse_dynamics(p + 0.05, np.eye(3), np.ones(6), a), np.linalg.solve(J.T, M @ a + G))


@pytest.mark.parametrize(("evaluation", "share"), [("online", 1.0), ("offline", 0.0)])
def test_offline_feedforward_omits_the_external_load(evaluation, share):
    settings = FeedforwardPDSettings.model_validate({"law": "feedforward_pd", **PD, "evaluation": evaluation})
    law, load = settings.build(context_of()), np.array([1e3, 2e3, 3e3, 100.0, 200.0, 300.0])
    bare = arrived(PLATFORM, PoseSample(*HOME, NONE, NONE))
    carried = asked(law, bare) - asked(law, altered(bare, wrench=load.tolist()))
    close(bare["J"].T @ carried, share * load)
