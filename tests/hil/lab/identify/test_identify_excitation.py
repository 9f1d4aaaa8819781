"""Excitations stay within the requested force and the frequency band of their loop, at any rate."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load
from hil.config.values import Pose
from hil.lab.identify.estimators.excitation import CARRIER_Hz, delay_excitation
from hil.lab.identify.runs import exact_model, excitation_pose
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.trajectory.build import build_trajectory
from tests.hil.test_dynamics import BOOK

FORCE_N = 40.0
Q = Rotation.from_rotvec([0.6, -0.7, 0.5]).as_matrix()
UPRIGHT = Rotation.from_rotvec([-np.pi / 2, 0.0, 0.0]).as_matrix()


def same_robot(base, platform):
    """The book's robot and its home, with base and platform axes rotated by these matrices."""
    g = BOOK["geometry"]
    body = {
        "mass": 1150.0, "com": [0.0, 0.0, 0.0],
        "inertia": (platform.T @ np.array(g["platform"]["inertia"]) @ platform).tolist(),
    }  # fmt: skip
    turned = {
        **g, "platform": body, "gravity": (base @ g["gravity"]).tolist(),
        "base_joints": (np.array(g["base_joints"]) @ base.T).tolist(),
        "platform_joints": (np.array(g["platform_joints"]) @ platform).tolist(),
    }  # fmt: skip
    p, r = base @ [0.0, 0.0, 1.0], np.rad2deg(Rotation.from_matrix(base @ platform).as_rotvec())
    return Model(Platform.from_dict(turned)), Pose(
        position_m=tuple(p.tolist()), rotation_vector_deg=tuple(r.tolist())
    )


TURNED = pytest.mark.parametrize(
    ("base", "platform"),
    [
        (np.eye(3), np.eye(3)),
        (np.eye(3), Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix()),
        (np.eye(3), Q),
        (UPRIGHT, np.eye(3)),
        (Q, Q),
    ],
    ids=["level", "platform about z", "platform", "wall", "both"],
)


def shaken(base, platform, frequencies):
    """The model, and the trajectory of the selected components without fading."""
    model, home = same_robot(base, platform)
    made = delay_excitation(model, home, 100.0, FORCE_N, 20.0)
    some = [s for s in made.components if frequencies(s.frequency_Hz)]
    return model, build_trajectory(made.model_copy(update={"components": some}), home, None)


@TURNED
def test_largest_leg_force_of_the_excitation_is_the_requested_one_at_any_home(base, platform):
    """Without weight and slow motion; lines at multiples of 2/3 Hz repeat after 1.5 s."""
    model, path = shaken(base, platform, lambda f: f != CARRIER_Hz)
    rest = model.inverse_dynamics(*path.sample(0.0)[:2], np.zeros(6), np.zeros(6))
    times = 1.0 + np.arange(0.0, 1.5, 1 / 400)
    forces = np.array([model.inverse_dynamics(*path.sample(t)) - rest for t in times.tolist()])
    assert np.abs(forces).max() == pytest.approx(FORCE_N, rel=0.05)


@pytest.mark.parametrize("rate_Hz", [25.0, 100.0, 149.0, 150.0, 1000.0])
def test_excitation_frequencies_for_the_delay_end_at_0_3_of_the_loop_rate(rate_Hz: float) -> None:
    c = load("virtual")
    reference = delay_excitation(exact_model(c), excitation_pose(c), rate_Hz, 100.0, 20.0)
    lines = np.unique([s.frequency_Hz for s in reference.components if s.frequency_Hz != CARRIER_Hz])
    assert lines.max() <= 0.3 * rate_Hz * (1.0 + 1e-9)
    assert len(lines) == 36, "six lines per axis, none shared by two axes"
