"""What acceleration of the legs a linearising law asks for, read back from its forces."""

import json
from pathlib import Path

import numpy as np

from hil.contracts.records import arrived, asked
from hil.control.law import LawContext
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample

BOOK = json.loads((Path(__file__).parents[2] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
HOME = np.array([0.1, -0.2, 1.1]), np.eye(3)
CONTEXT = LawContext(PLATFORM, "none", 1e-3, HoldTrajectory(*HOME))
NONE = np.zeros(6)


def at_rest(e, de):
    """The platform at rest at one pose, with errors e and de of the lengths and rates; and its inertia."""
    tick = arrived(PLATFORM, PoseSample(*HOME, NONE, NONE))
    tick["q"] -= e
    tick["dq"] -= de
    inverse = np.linalg.inv(tick["J"])
    return tick, inverse.T @ Model(PLATFORM).mass_matrix(*HOME) @ inverse


def answer(law, e, de):
    """The acceleration that the law asks for beyond the reference's."""
    tick, inertia = at_rest(e, de)
    tau = asked(law, tick) - asked(law, at_rest(NONE, NONE)[0])
    return np.linalg.solve(inertia, tau)
