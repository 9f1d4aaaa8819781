"""Faults that act together on one leg add up, and loads weigh whichever way gravity points."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plant_fmu.faults.encoder import EncoderDrift, EncoderJump
from plant_fmu.faults.plan import weight
from plant_fmu.plant import Truth
from tests.plant_fmu.test_fault_kinds import accelerating, motion, read

DRIFTS = (EncoderDrift(leg=2, by_m_s=0.5), EncoderDrift(leg=2, by_m_s=0.25, at_s=1e-3))
JUMP = EncoderJump(leg=2, by_m=3e-3)
OTHER = EncoderDrift(leg=4, by_m_s=-0.5)


@pytest.mark.parametrize("faults", list(itertools.permutations((*DRIFTS, JUMP, OTHER))))
def test_drifts_and_a_jump_of_one_encoder_add_up_in_any_order(faults):
    rig = accelerating(*faults)
    l, dl = motion(5)
    assert read(rig, 5) == pytest.approx((l + 3e-3 + 0.5 * 5e-3 + 0.25 * 4e-3, dl + 0.75), abs=1e-9)
    l, dl = motion(6)
    assert read(rig, 6, leg=4) == pytest.approx((l - 0.5 * 6e-3, dl - 0.5), abs=1e-9)


@pytest.mark.parametrize("along", range(3))
@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("arm", range(3))
def test_a_load_turns_the_platform_by_its_arm_whichever_way_gravity_points(along, side, arm):
    gravity, position = np.zeros(3), np.zeros(3)
    gravity[along], position[arm] = 10.0 * side, 0.5
    turned = Rotation.from_euler("z", 90, degrees=True).as_matrix()  # x of the platform is y of the base
    for R, axis, sign in ((np.eye(3), arm, 1.0), (turned, (1, 0, 2)[arm], (1.0, -1.0, 1.0)[arm])):
        truth = Truth(np.zeros(3), R, np.zeros(6), np.zeros(6))
        wrench = weight([(2.0, position), (4.0, np.zeros(3))], truth, gravity)
        moment = np.zeros(3)
        third = 3 - axis - along
        if axis != along:  # e_axis x e_along is the third axis, with the sign of the order
            moment[third] = sign * side * 0.5 * 20.0 * (1.0 if (along - axis) % 3 == 1 else -1.0)
        np.testing.assert_allclose(wrench[:3], 6.0 * gravity, rtol=1e-15)
        np.testing.assert_allclose(wrench[3:], moment, rtol=0, atol=1e-14)
