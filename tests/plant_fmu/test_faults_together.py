"""Faults that act together on one leg add up or multiply, and loads weigh whichever way gravity points."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plant_fmu.faults.kinds import EncoderDrift, EncoderJump, EncoderScale, EncoderSign
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


SCALE, SIGN = partial(EncoderScale, leg=2, factor=1.5), partial(EncoderSign, leg=2)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    ("kinds", "first", "second"),
    [
        ((SCALE, SIGN), 1.5, -1.0),
        ((SIGN, SCALE), -1.0, 1.5),
        ((SCALE, SCALE), 1.5, 1.5),
        ((SIGN, SIGN), -1.0, -1.0),
    ],
)
def test_an_encoder_that_is_scaled_once_more_goes_on_from_what_it_reads(kinds, first, second, swapped):
    faults = [kinds[0](at_s=2e-3), kinds[1](at_s=4e-3)]
    rig = accelerating(*(faults[::-1] if swapped else faults))
    begun, again = motion(2)[0], motion(4)[0]
    read_then = begun + first * (again - begun)
    assert read(rig, 3) == pytest.approx(
        (begun + first * (motion(3)[0] - begun), first * motion(3)[1]), abs=1e-9
    )
    both = first * second
    for t_ms in (4, 6):
        l, dl = motion(t_ms)
        assert read(rig, t_ms) == pytest.approx((read_then + both * (l - again), both * dl), abs=1e-9)
    l, dl = motion(7)
    assert read(rig, 7, leg=3) == pytest.approx((l, dl), abs=1e-9)


@pytest.mark.parametrize("kind", [SCALE, SIGN])
def test_a_scale_that_outlasts_another_counts_from_its_own_beginning(kind):
    factor = 1.5 if kind is SCALE else -1.0
    rig = accelerating(kind(at_s=2e-3, for_s=3e-3), kind(at_s=4e-3))
    l, dl = motion(6)
    again = motion(4)[0]
    assert read(rig, 6) == pytest.approx((again + factor * (l - again), factor * dl), abs=1e-9)


@pytest.mark.parametrize("kind", [SCALE, SIGN])
def test_a_scale_that_comes_a_second_time_counts_from_there(kind):
    factor = 1.5 if kind is SCALE else -1.0
    rig = accelerating(kind(at_s=1e-3, for_s=2e-3), kind(at_s=5e-3))
    assert read(rig, 4) == pytest.approx(motion(4), abs=1e-9), "it works meanwhile"
    l, dl = motion(7)
    again = motion(5)[0]
    assert read(rig, 7) == pytest.approx((again + factor * (l - again), factor * dl), abs=1e-9)
