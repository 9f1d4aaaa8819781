"""PD with gravity compensation: the engines' weight at the measured pose, and no error at rest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.config import ModelSettings, PDGravitySettings, Pose
from hil.control import LawContext, build_law
from hil.loop.reference import complete
from hil.robot.geometry import Platform
from hil.signals import State
from hil.trajectory import PoseSample, hold

TRUTH = json.loads((Path(__file__).parents[2] / "data" / "rigid_body_cases.json").read_text())
NONE = np.zeros(6)


def law_of(platform, **model):
    settings = PDGravitySettings(law="pd_gravity", kp_N_m=2e6, kv_N_s_m=5e4, model=ModelSettings(**model))
    return build_law(settings, LawContext(platform, "none", 1e-3, hold(np.zeros(3), np.eye(3))))


@pytest.mark.parametrize("case", TRUTH["cases"][::3], ids=lambda c: c["id"])
def test_the_compensation_is_the_engines_gravity_at_the_measured_pose_whatever_the_speed(case):
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
    J, q, dq = (np.array(e[key]) for key in ("jacobian", "lengths", "rates"))
    elsewhere = complete(platform, PoseSample(p + 0.01, R, NONE, np.ones(6)))
    weight = np.linalg.solve(J.T, e["G"])
    tau = law_of(platform).effort(State(q, dq, p, R, twist, J, 0, 0.0), elsewhere, NONE).tau
    expected = 2e6 * (elsewhere.q - q) - 5e4 * dq + weight
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_the_model_may_be_the_gravity_of_one_pose():
    book = Platform.from_dict(TRUTH["geometries"][TRUTH["cases"][0]["geometry"]])
    s = TRUTH["cases"][0]["state"]
    p, R = np.array(s["p"]), np.array(s["R"])
    home = np.array([0.0, 0.0, p[2]])
    law = law_of(book, variant="constant", frozen_at=Pose(position_m=tuple(home)))
    here, there = (complete(book, PoseSample(x, r, NONE, NONE)) for x, r in ((p, R), (home, np.eye(3))))
    tau = [
        law.effort(State(r.q, r.dq, r.p, r.R, NONE, np.eye(6), 0, 0.0), r, NONE).tau for r in (here, there)
    ]
    assert tau[0].tobytes() == tau[1].tobytes()
    assert np.isfinite(tau[0]).all()
