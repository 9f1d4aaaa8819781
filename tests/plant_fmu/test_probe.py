"""Pushing a plant: the response of each leg to each push, and whether the legs are coupled."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.arrays import Array
from plant_fmu.fmu.probe import Probe, probe

MOBILITY = 0.01 * np.arange(36.0).reshape(6, 6) + np.eye(6)
FALL = np.arange(6.0) - 9.0
DT = 0.5


class Answers:
    """Plant whose legs have the acceleration MOBILITY f + FALL."""

    internal_step_s = DT

    def reset(self) -> tuple[Array, Array]:
        self.rate = np.full(6, 0.25)
        return np.arange(6.0) + 1.0, self.rate.copy()

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        assert not brake.any()
        assert not wrench.any()
        self.rate += (MOBILITY @ force + FALL) * dt_s
        return np.zeros(6), self.rate.copy()


@pytest.mark.parametrize("force_N", [2.0, -4.0])
def test_coupling_probe_of_an_fmu_pushes_each_leg_alone_from_the_initial_state(force_N):
    plant = Answers()
    found = probe(plant, force_N, DT)  # type: ignore[arg-type]
    np.testing.assert_allclose(found.acceleration, FALL, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.mobility, MOBILITY, rtol=0, atol=1e-12)
    assert (plant.rate == 0.25).all(), "the probe resets the plant afterwards"


@pytest.mark.parametrize("place", [(0, 5), (5, 0), (2, 3)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_fmu_legs_count_as_uncoupled_if_each_moves_the_others_by_less_than_a_thousandth(place, sign):
    own = np.array([0.02, -0.03, 0.01, 1.0, 2.0, 0.05])
    for share, single in ((0.9e-3, True), (1e-3, False), (1.1e-3, False), (1.0, False)):
        mobility = np.diag(own)
        mobility[place] = sign * share * 0.01
        assert Probe(np.zeros(6), mobility).uncoupled is single


@pytest.mark.parametrize("answer", [0.0, np.nan])
def test_coupling_of_fmu_legs_is_unknown_unless_every_leg_responds(answer):
    assert Probe(np.zeros(6), np.diag([1.0, 1.0, 1.0, answer, 1.0, 1.0])).uncoupled is None
