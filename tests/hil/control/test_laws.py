"""The contract that every control law keeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.config import ControllerSettings, InverseDynamicsSettings, ModelSettings, PDSettings, Pose
from hil.control import LAWS, build_law
from hil.geometry import Platform
from hil.kinematics import jacobian, leg_lengths
from hil.reference import complete
from hil.rotations import rotation_from_vector
from hil.signals import State
from hil.trajectory import PoseSample

BOOK = json.loads((Path(__file__).parents[2] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
SETTINGS: dict[str, ControllerSettings] = {
    "pd": PDSettings(law="pd", kp_N_m=2e6, kv_N_s_m=5e4),
    "inverse_dynamics": InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=20.0),
    "inverse_dynamics, constant": InverseDynamicsSettings(
        law="inverse_dynamics",
        wn_rad_s=20.0,
        model=ModelSettings(variant="constant", frozen_at=Pose(position_m=(0, 0, 1))),
    ),
}
laws = pytest.mark.parametrize("name", SETTINGS)


def make(name):
    return build_law(SETTINGS[name], PLATFORM, "none")


def sample(case):
    R = rotation_from_vector(np.array(case["rotvec"]))
    twist, dtwist = np.array(case["v"] + case["omega"]), np.array(case["a"] + case["alpha"])
    return PoseSample(np.array(case["p"]), R, twist, dtwist)


def on_reference(s):
    r = complete(PLATFORM, s)
    return State(r.q, r.dq, s.p, s.R, s.twist, jacobian(PLATFORM, s.p, s.R), 0, 0.0), r


def test_every_law_of_the_table_is_under_contract():
    assert {n.split(",")[0] for n in SETTINGS} == set(LAWS)


@laws
def test_finite_in_finite_out(name):
    law = make(name)
    random = np.random.default_rng(7)
    for case in BOOK["states"]:
        state, reference = on_reference(sample(case))
        state = state._replace(q=state.q + random.normal(0, 0.01, 6), dq=state.dq + random.normal(0, 0.1, 6))
        assert np.isfinite(law.effort(state, reference).tau).all()


@laws
def test_reset_repeats_to_the_bit(name):
    law = make(name)
    pairs = [on_reference(sample(case)) for case in BOOK["states"]]
    first = [law.effort(*pair).tau.tobytes() for pair in pairs]
    law.reset()
    assert [law.effort(*pair).tau.tobytes() for pair in pairs] == first


@laws
def test_singular_jacobian_gives_no_number_or_a_finite_one_but_never_raises(name):
    law = make(name)
    state, reference = on_reference(sample(BOOK["states"][0]))
    tau = law.effort(state._replace(J=np.zeros((6, 6))), reference).tau
    assert tau.shape == (6,)
    if name == "inverse_dynamics":
        assert np.isnan(tau).any()


def test_pd_without_error_is_zero_and_with_error_is_the_gains():
    law = make("pd")
    state, reference = on_reference(sample(BOOK["states"][0]))
    assert not law.effort(state, reference).tau.any()
    e = np.array([1e-3, 0, -2e-3, 0, 0, 0])
    np.testing.assert_allclose(law.effort(state._replace(q=state.q - e), reference).tau, 2e6 * e, atol=1e-6)
    np.testing.assert_allclose(law.effort(state._replace(dq=state.dq - e), reference).tau, 5e4 * e, atol=1e-9)


@pytest.mark.parametrize("case", BOOK["states"], ids=lambda c: f"t={c['t']:.2f}")
def test_exact_inverse_dynamics_without_error_is_the_forces_of_the_book(case):
    """41 states of the book's trajectory; forces confirmed by an independent engine to 1.6e-11 N."""
    tau = make("inverse_dynamics").effort(*on_reference(sample(case))).tau
    np.testing.assert_allclose(tau, case["force"], rtol=0, atol=1e-8 * np.abs(case["force"]).max())


def test_exact_inverse_dynamics_answers_an_error_with_the_reflected_inertia():
    """An error E in the lengths adds J^-T M J^-1 K_P E, and that inertia is symmetric and positive definite."""
    law = make("inverse_dynamics")
    state, reference = on_reference(sample(BOOK["states"][10]))
    base = law.effort(state, reference).tau
    inertia = np.column_stack(
        [law.effort(state, reference._replace(ddq=reference.ddq + d)).tau - base for d in np.eye(6)]
    )
    e = np.array([3e-3, -1e-3, 2e-3, 0, 1e-3, -4e-3])
    tau = law.effort(state._replace(q=state.q - e), reference).tau - base
    np.testing.assert_allclose(tau, inertia @ (400.0 * e), rtol=1e-7, atol=1e-6)
    assert (np.linalg.eigvalsh((inertia + inertia.T) / 2) > 0).all()
    np.testing.assert_allclose(inertia, inertia.T, rtol=1e-6, atol=1e-6 * np.abs(inertia).max())


def test_lengths_are_those_of_the_book():
    case = BOOK["states"][20]
    s = sample(case)
    np.testing.assert_allclose(leg_lengths(PLATFORM, s.p, s.R), case["length"], atol=1e-11)
