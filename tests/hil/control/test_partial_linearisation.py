"""Inverse dynamics without H and load: the engines' M, G and J, and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from hil.contracts.records import asked, referred
from hil.control.law import LawContext
from hil.control.partial_linearisation import PartialLinearisationSettings
from hil.robot.geometry import Platform
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample

TRUTH = json.loads((Path(__file__).parents[2] / "data" / "rigid_body_cases.json").read_text())
SETTINGS = PartialLinearisationSettings(law="partial_linearisation", wn_rad_s=20.0, damping_ratio=0.5)


@pytest.mark.parametrize("case", TRUTH["cases"], ids=lambda c: c["id"])
def test_it_asks_for_the_engines_inertia_and_weight_and_leaves_H_and_load_out(case):
    """ddq_d - (dJ/dt) twist = J dtwist on the reference; an error E adds J^-T M J^-1 (K_P E + K_D dE)."""
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
    dtwist = np.array(s["a"] + s["alpha"])
    J, M, G, q, dq = (np.array(e[key]) for key in ("jacobian", "M", "G", "lengths", "rates"))
    law = SETTINGS.build(LawContext(platform, "none", 1e-3, HoldTrajectory(np.zeros(3), np.eye(3))))
    E, dE = np.array([1e-3, 0, -2e-3, 0, 3e-3, 0]), np.array([0, 1e-2, 0, 0, -2e-2, 0])
    state = {"q": q - E, "dq": dq - dE, "p": p, "R": R, "twist": twist, "J": J, "wrench": s["wrench"]}
    tau = asked(law, referred(platform, PoseSample(p, R, twist, dtwist), **state))
    correction = np.linalg.solve(J, 400.0 * E + 20.0 * dE)
    expected = np.linalg.solve(J.T, M @ (dtwist + correction) + G)
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_its_model_has_no_variant_to_choose():
    with pytest.raises(ValidationError, match="variant"):
        PartialLinearisationSettings.model_validate(
            {"law": "partial_linearisation", "wn_rad_s": 20, "model": {"variant": "full"}}
        )
