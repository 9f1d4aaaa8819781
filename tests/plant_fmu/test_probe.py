"""Pushing a plant: what its legs answer, each to each, and whether they are single."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.arrays import Array
from plant_fmu.fmu.probe import Probe, probe
from plant_fmu.plant import Truth

MOBILITY = 0.01 * np.arange(36.0).reshape(6, 6) + np.eye(6)
FALL = np.arange(6.0) - 9.0
DT = 0.5
CALM = np.zeros(6)


class Answers:
    """Plant whose legs are accelerated by MOBILITY f and fall besides."""

    internal_step_s = DT

    def __init__(self) -> None:
        self.calls: list[str] = []

    def reset(self) -> tuple[Array, Array]:
        self.calls.append("reset")
        self.rate = np.full(6, 0.25)
        return np.arange(6.0) + 1.0, self.rate.copy()

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self.calls.append("step")
        assert force.shape == brake.shape == wrench.shape == (6,)
        assert not brake.any()
        assert not wrench.any()
        self.rate += (MOBILITY @ force + FALL) * dt_s
        return np.zeros(6), self.rate.copy()

    def truth(self) -> Truth | None:
        return None

    def applied_force(self) -> Array | None:
        return None

    def close(self) -> None:
        """Nothing to free."""


@pytest.mark.parametrize("force_N", [2.0, -4.0])
def test_each_leg_is_pushed_once_from_the_start_and_the_plant_stands_there_afterwards(force_N):
    plant = Answers()
    found = probe(plant, force_N, DT)
    np.testing.assert_allclose(found.acceleration, FALL, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.mobility, MOBILITY, rtol=0, atol=1e-12)
    assert plant.calls == [*["reset", "step"] * 7, "reset"]


@pytest.mark.parametrize("place", [(0, 5), (5, 0), (2, 3)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_legs_are_single_whose_answers_to_others_are_below_a_thousandth_of_the_least_own_one(place, sign):
    own = np.array([0.02, -0.03, 0.01, 1.0, 2.0, 0.05])
    for share, single in ((0.9e-3, True), (1e-3, False), (1.1e-3, False), (1.0, False)):
        mobility = np.diag(own)
        mobility[place] = sign * share * 0.01
        assert Probe(CALM, mobility).uncoupled is single
    assert Probe(CALM, np.diag(own)).uncoupled is True


@pytest.mark.parametrize("leg", range(6))
def test_where_one_push_moves_nothing_nobody_can_tell(leg):
    for answer in (0.0, np.nan):
        own = np.ones(6)
        own[leg] = answer
        assert Probe(CALM, np.diag(own)).uncoupled is None
