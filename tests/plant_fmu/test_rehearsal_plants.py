"""Legs on trestles, and the cables in front of them."""

import numpy as np
import pytest

from drivers.arrays import Array
from plant_fmu.bench import HAND_M, HAND_m_s
from plant_fmu.plant import truth_of
from plant_fmu.rehearsal.bench import TrestleLegs
from plant_fmu.rehearsal.wired_plant import WiredPlant
from plant_fmu.rehearsal.wiring import Wiring
from tests.plant_fmu.rig import Masses

SIX = np.arange(6.0)
CALM = OPEN = np.zeros(6)
SHUT = np.ones(6)
MIDDLE = 0.5 + 0.01 * SIX


class Legs(Masses):
    """Plant that stores its inputs and stays where the test puts it."""

    length: Array = MIDDLE - 0.1
    rate: Array = CALM

    def reset(self) -> tuple[Array, Array]:
        return self.length, self.rate

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self.force, self.brake = force, brake
        return self.length, self.rate


def wired(wiring: Wiring) -> tuple[WiredPlant, Legs]:
    legs = Legs()
    plant = WiredPlant(legs, wiring, MIDDLE)
    plant.reset()
    return plant, legs


def test_drives_behind_wrong_cables_report_their_own_forces_and_not_those_of_the_legs():
    plant, legs = wired(Wiring(motor=(1, 0, 2, 3, 4, 5)))
    legs.truth = lambda: truth_of(np.zeros(24))  # type: ignore[method-assign]
    force = 100.0 + SIX
    plant.step(force, OPEN, CALM, 1e-3)
    assert legs.force[:2].tolist() == [101.0, 100.0]
    truth = plant.truth()
    assert truth is not None
    assert truth.applied_force.tolist() == force.tolist()


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("leg", range(6))
def test_simulated_hand_moves_a_leg_at_hand_speed_up_to_its_reach(side, leg):
    start = np.full(6, 0.5)
    legs = TrestleLegs(100.0, mass=20.0, friction=10.0, brake=1e4, shortest=0.2, longest=0.8, x=start)
    legs.push(leg, side * 500.0)
    rates = [legs.step(CALM, CALM, CALM, 1e-3)[1][leg] for _ in range(20)]
    assert max(side * np.array(rates)) == pytest.approx(HAND_m_s, rel=0.02)
    for k in (1, 2):  # a repeated push begins where the leg is
        x, v = legs.step(CALM, CALM, CALM, 0.2)
        reached = start.copy()
        reached[leg] += k * side * HAND_M
        np.testing.assert_allclose(x, reached, rtol=0, atol=1e-15)
        assert v.tolist() == [0.0] * 6
        legs.push(leg, side * 500.0)


def test_each_simulated_encoder_reads_the_leg_it_is_wired_to_with_its_own_errors():
    wiring = Wiring(
        encoder=(1, 0, 2, 3, 4, 5),
        scale=(2.0, 1.0, -1.0, 1.0, 1.0, 1.0),
        offset_m=(0.0, 0.003, 0.0, 0.0, 0.0, 0.0),
        jump_m=(0.0, 0.0, 0.0, 0.006, 0.0, 0.0),
        stops=(False, False, False, False, True, False),
        frozen=(False, False, False, False, False, True),
    )
    plant, legs = wired(wiring)
    legs.length, legs.rate = MIDDLE + 0.02, 0.1 + 0.01 * SIX
    reads, rates = plant.step(CALM, CALM, CALM, 1e-4)
    moved = [0.51 + 2 * 0.02, 0.5 + 0.02 + 0.003, 0.52 - 0.02, 0.53 + 0.02 + 0.006, 0.54, 0.55 - 0.1]
    np.testing.assert_allclose(reads, moved, rtol=0, atol=1e-15)
    np.testing.assert_allclose(rates, [2 * 0.11, 0.1, -0.12, 0.13, 0.14, 0.0], rtol=1e-15)
    legs.length = MIDDLE - 0.02
    reads, _ = plant.step(CALM, CALM, CALM, 1e-4)
    np.testing.assert_allclose(reads[3:5], [0.53 - 0.02, 0.54 - 0.02], rtol=0, atol=1e-15)
    legs.length = MIDDLE - 0.03
    reads, _ = plant.reset()
    assert reads[5] == pytest.approx(0.52, abs=1e-15)  # frozen at this power-up


def test_encoder_with_backlash_follows_its_leg_after_the_backlash_is_used_up():
    plant, legs = wired(Wiring(play_m=(0.005,) * 6))
    seen = []
    for by in (0.0, 0.003, 0.012, 0.009, 0.006):
        legs.length = MIDDLE - 0.1 + by
        seen.append(plant.step(CALM, CALM, CALM, 1e-4)[0][3] - (MIDDLE[3] - 0.1))
    np.testing.assert_allclose(seen, [0.0, 0.0, 0.007, 0.007, 0.006], atol=1e-15)
    legs.length = MIDDLE - 0.1 + 0.009
    reads, _ = plant.reset()
    np.testing.assert_allclose(reads, legs.length, atol=1e-15)  # at power-up, the reading is the length


def test_delayed_encoders_lagging_forces_and_slipping_couplings_follow_their_time_laws():
    """Steps of 1 ms: reading 3 ms old, force with a lag of 20 ms (1 - (1 - 1/20)^n), coupling of 10 N."""
    legs = Legs()
    wiring = Wiring(
        force_lag_s=(0.0, 0.02, 0.0, 0.0, 0.0, 0.0),
        encoder_late_s=(0.0, 0.0, 3e-3, 0.0, 0.0, 0.0),
        coupling=(np.inf, np.inf, np.inf, 0.1, np.inf, np.inf),
    )
    legs.internal_step_s = 1e-3
    plant = WiredPlant(legs, wiring, MIDDLE, 100.0)
    plant.reset()
    seen = []
    for n in range(6):
        legs.length = MIDDLE - 0.1 + 0.001 * (n + 1)
        reads, _ = plant.step(np.full(6, 30.0), CALM, CALM, 1e-3)
        seen.append(reads - (MIDDLE - 0.1))
        assert legs.force[0] == 30.0
        assert legs.force[1] == pytest.approx(30.0 * (1.0 - 0.95 ** (n + 1)))
        assert legs.force[3] == pytest.approx(10.0)
    np.testing.assert_allclose([each[0] for each in seen], 0.001 * np.arange(1, 7), atol=1e-12)
    np.testing.assert_allclose([each[2] for each in seen], [0.0, 0.0, 0.0, 0.001, 0.002, 0.003], atol=1e-12)
    slips = [each[3] - each[0] for each in seen]
    assert min(np.diff(slips)) > 0.0, "a motor whose coupling slips runs ahead of its leg"


def test_brake_with_slow_closing_opens_in_time_and_closes_late():
    legs = Legs()
    legs.internal_step_s = 1e-3
    plant = WiredPlant(legs, Wiring(brake_late_s=(0.0, 2e-3, 0.0, 0.0, 0.0, 0.0)), MIDDLE)
    plant.reset()
    held = []
    for brake in (SHUT, OPEN, SHUT, SHUT, SHUT):
        plant.step(CALM, brake, CALM, 1e-3)
        held.append(legs.brake[:2].tolist())
    assert held == [[1, 1], [0, 0], [1, 0], [1, 0], [1, 1]]


def trestles(friction_N: Array = CALM, brake_N: float = 1000.0, start: float = 0.3) -> TrestleLegs:
    return TrestleLegs(
        6.0,
        mass=4.0 + SIX,
        friction=friction_N,
        brake=brake_N + SIX,
        shortest=0.25 - 0.001 * SIX,
        longest=0.35 + 0.001 * SIX,
        x=start,
    )


def test_each_leg_has_its_own_brake_and_its_own_ends_of_travel():
    legs = trestles(brake_N=2.0)
    _, v = legs.step(np.full(6, 9.0), np.ones(6), CALM, 0.01)
    np.testing.assert_allclose(v, (9.0 - (2.0 + SIX)) / (4.0 + SIX) * 0.01, rtol=0.03)
    for force, ends in ((-90.0, 0.25 - 0.001 * SIX), (90.0, 0.35 + 0.001 * SIX)):
        x, _ = legs.step(np.full(6, force), CALM, CALM, 2.0)
        np.testing.assert_array_equal(x, ends)
