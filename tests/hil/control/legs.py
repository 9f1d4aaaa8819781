"""States of the book and of independent rigid-body engines, and the acceleration that a law requests."""

import json
from pathlib import Path

import numpy as np
import pytest

from hil.contracts.records import arrived, asked
from hil.control.law import LawContext
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.trajectory.path import PoseSample

DATA = Path(__file__).parents[2] / "data"
BOOK = json.loads((DATA / "book_platform.json").read_text())
TRUTH = json.loads((DATA / "rigid_body_cases.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
HOME = np.array([0.1, -0.2, 1.1]), np.eye(3)
CONTEXT = LawContext(PLATFORM, "none", 1e-3)
NONE = np.zeros(6)


def context_of(platform=PLATFORM, period_s=1e-3, **more):
    return LawContext(platform, "none", period_s, **more)


def engines(case):
    """Platform, state as columns of a tick, and sample of one case of the rigid-body engines."""
    s, e = case["state"], case["expected"]
    p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
    J, q, dq = (np.array(e[key]) for key in ("jacobian", "lengths", "rates"))
    state = {"q": q, "dq": dq, "p": p, "R": R, "twist": twist, "J": J}
    sample = PoseSample(p, R, twist, np.array(s["a"] + s["alpha"]))
    return Platform.from_dict(TRUTH["geometries"][case["geometry"]]), state, sample


def cases(step):
    """Parametrise `case` with every `step`-th case of the engines."""
    return pytest.mark.parametrize("case", TRUTH["cases"][::step], ids=lambda c: c["id"])


def close(found, expected, share=1e-9):
    np.testing.assert_allclose(found, expected, rtol=0, atol=share * np.abs(expected).max())


def at_rest(e, de):
    """The platform at rest with errors e and de of leg lengths and rates; and its inertia in leg space."""
    tick = arrived(PLATFORM, PoseSample(*HOME, NONE, NONE))
    tick["q"] -= e
    tick["dq"] -= de
    inverse = np.linalg.inv(tick["J"])
    return tick, inverse.T @ Model(PLATFORM).mass_matrix(*HOME) @ inverse


def answer(law, e, de):
    """Leg acceleration that the law requests for the errors, in addition to the reference's."""
    tick, inertia = at_rest(e, de)
    tau = asked(law, tick) - asked(law, at_rest(NONE, NONE)[0])
    return np.linalg.solve(inertia, tau)
