"""What acceleration of the legs a linearising law asks for, read back from its forces."""

import json
from pathlib import Path

import numpy as np

from hil.control import LawContext
from hil.loop.reference import complete
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.signals import State
from hil.trajectory import PoseSample, hold

BOOK = json.loads((Path(__file__).parents[2] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
HOME = np.array([0.1, -0.2, 1.1]), np.eye(3)
CONTEXT = LawContext(PLATFORM, "none", 1e-3, hold(*HOME))
NONE = np.zeros(6)


def at_rest(e, de):
    """The platform at rest at one pose, with errors e and de of the lengths and rates; and its inertia."""
    p, R = HOME
    J = jacobian(PLATFORM, p, R)
    reference = complete(PLATFORM, PoseSample(p, R, NONE, NONE))
    state = State(reference.q - e, reference.dq - de, p, R, NONE, J, 0, 0.0)
    inverse = np.linalg.inv(J)
    return state, reference, inverse.T @ Model(PLATFORM).mass_matrix(p, R) @ inverse


def answer(law, e, de):
    """The acceleration that the law asks for beyond the reference's."""
    state, reference, inertia = at_rest(e, de)
    tau = law.effort(state, reference, NONE).tau - law.effort(*at_rest(NONE, NONE)[:2], NONE).tau
    return np.linalg.solve(inertia, tau)
