"""PD with gravity compensation: the engines' weight at the measured pose, and no error at rest."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.config.model import ModelSettings
from hil.config.values import Pose
from hil.contracts.records import arrived, asked, referred
from hil.control.law import LawContext
from hil.control.pd_gravity import PDGravitySettings
from hil.robot.geometry import Platform
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample

TRUTH = json.loads((Path(__file__).parents[2] / "data" / "rigid_body_cases.json").read_text())
NONE = np.zeros(6)


def law_of(platform, **model):
    settings = PDGravitySettings(law="pd_gravity", kp_N_m=2e6, kv_N_s_m=5e4, model=ModelSettings(**model))
    return settings.build(LawContext(platform, "none", 1e-3, HoldTrajectory(np.zeros(3), np.eye(3))))


@pytest.mark.parametrize("case", TRUTH["cases"][::3], ids=lambda c: c["id"])
def test_the_compensation_is_the_engines_gravity_at_the_measured_pose_whatever_the_speed(case):
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
    J, q, dq = (np.array(e[key]) for key in ("jacobian", "lengths", "rates"))
    state = {"q": q, "dq": dq, "p": p, "R": R, "twist": twist, "J": J}
    elsewhere = referred(platform, PoseSample(p + 0.01, R, NONE, np.ones(6)), **state)
    weight = np.linalg.solve(J.T, e["G"])
    tau = asked(law_of(platform), elsewhere)
    expected = 2e6 * (elsewhere["q_d"] - q) - 5e4 * dq + weight
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_the_model_may_be_the_gravity_of_one_pose():
    book = Platform.from_dict(TRUTH["geometries"][TRUTH["cases"][0]["geometry"]])
    s = TRUTH["cases"][0]["state"]
    p, R = np.array(s["p"]), np.array(s["R"])
    home = np.array([0.0, 0.0, p[2]])
    law = law_of(book, variant="constant", frozen_at=Pose(position_m=tuple(home)))
    poses = ((p, R), (home, np.eye(3)))
    tau = [asked(law, arrived(book, PoseSample(x, r, NONE, NONE), J=np.eye(6))) for x, r in poses]
    assert tau[0].tobytes() == tau[1].tobytes()
    assert np.isfinite(tau[0]).all()
