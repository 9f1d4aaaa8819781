"""Excitation of the axes by `hil identify`, and the part of a log that it uses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load
from hil.config.reference import Sinusoid, SinusoidReference
from hil.config.values import Pose
from hil.lab.identify.estimators.excitation import axis_excitation
from hil.lab.identify.linearised import linearised_law, repeating


@pytest.mark.parametrize("space", ["joint", "pose"])
def test_each_excitation_frequency_moves_only_its_own_axis_at_a_rotated_pose(space):
    """By differences: change of the legs, or shift and rotation in base axes, for a small step along each line."""
    model = linearised_law(load("virtual")).model
    home = Pose(position_m=(0.05, -0.1, 1.05), rotation_vector_deg=(14.0, -11.0, 17.0))
    made = axis_excitation(model, home, space, 1000.0, 300.0, None)
    words = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
    lines: dict[float, np.ndarray] = {}
    for c in made.components:
        lines.setdefault(c.frequency_Hz, np.zeros(6))[words.index(c.axis)] = c.amplitude
    at = np.array([*home.position_m, *home.rotation_vector_deg])

    def axes(pose):
        R = Rotation.from_rotvec(np.deg2rad(pose[3:]))
        turn = R * Rotation.from_rotvec(np.deg2rad(at[3:])).inv()
        if space == "pose":
            return np.concatenate([pose[:3], turn.as_rotvec()])
        joints = pose[:3] + R.apply(np.array(model.platform.platform_joints))
        return np.linalg.norm(joints - model.platform.base_joints, axis=1)

    counted = np.zeros(6, int)
    for f, way in lines.items():
        small = 1e-4 * way / np.abs(way).max()
        moved = np.abs(axes(at + small) - axes(at - small))
        if f >= 1.0:
            axis = int(np.argmax(moved))
            counted[axis] += 1
            assert np.delete(moved, axis).max() < 1e-4 * moved[axis]
        elif space == "joint":
            assert np.ptp(moved) < 1e-4 * moved.max(), "in the slow motion all legs extend at one speed"
    assert (counted == 12).all()
    assert len(lines) == 73


def sinusoids(*frequencies, duration_s=10.0):
    components = [Sinusoid(axis="z_m", amplitude=1e-3, frequency_Hz=f) for f in frequencies]
    return SinusoidReference(
        type="sinusoids", centre=Pose(position_m=(0, 0, 1)), components=components, ramp_s=1.0,
        duration_s=duration_s,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("reference", "rate_Hz", "expected"),
    [
        (sinusoids(1.5, 2.5, 1e-4), 1000.0, (2000, [3, 5])),
        (sinusoids(1.5, 490.0), 1000.0, (2000, [3])),  # too near to half the rate
        (sinusoids(1.0, 2**0.5), 1000.0, None),
        (sinusoids(1.0, 1.01), 1000.0, None),  # a period of 100 s
        (load("virtual").reference, 1000.0, None),
    ],
    ids=["all lines", "too fast", "never", "too long", "other motion"],
)
def test_excitation_period_is_the_common_period_of_all_frequencies_or_none(reference, rate_Hz, expected):
    lines = repeating(reference, rate_Hz)
    assert (None if lines is None else (lines[0], lines[1].tolist())) == expected
