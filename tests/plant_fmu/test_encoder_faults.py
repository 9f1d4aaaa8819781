"""Encoder faults: readings of legs whose motion is known in closed form."""

from __future__ import annotations

import itertools
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveFault, Reaction
from plant_fmu.faults import kinds
from tests.plant_fmu.rig import MASS, MS, REST, Rig, accelerating, motion, read

DRIFTS = (kinds.EncoderDrift(leg=2, by_m_s=0.5), kinds.EncoderDrift(leg=2, by_m_s=0.25, at_s=1e-3))
JUMP = kinds.EncoderJump(leg=2, by_m=3e-3)


def test_encoder_drift_fault_shifts_the_reading_at_the_given_rate_until_the_fault_ends():
    rig = accelerating(kinds.EncoderDrift(leg=2, by_m_s=0.5, at_s=2e-3, for_s=4e-3))
    for t_ms, drifted, rate in ((1, 0, 0), (2, 0, 0.5), (4, 1e-3, 0.5), (5, 1.5e-3, 0.5), (7, 0, 0)):
        l, dl = motion(t_ms)
        assert read(rig, t_ms) == pytest.approx((l + drifted, dl + rate), abs=1e-9)
    assert rig.nodes.snapshot().length[2] - REST[2] == pytest.approx(motion(7)[0])


SCALE, SIGN = partial(kinds.EncoderScale, leg=2, factor=1.5), partial(kinds.EncoderSign, leg=2)


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    ("pair", "first", "second"),
    [
        ((SCALE, SIGN), 1.5, -1.0),
        ((SIGN, SCALE), -1.0, 1.5),
        ((SCALE, SCALE), 1.5, 1.5),
        ((SIGN, SIGN), -1.0, -1.0),
    ],
)
def test_second_encoder_scale_or_sign_fault_continues_from_the_current_reading(pair, first, second, swapped):
    faults = [pair[0](at_s=2e-3), pair[1](at_s=4e-3)]
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


@pytest.mark.parametrize("faults", list(itertools.permutations((*DRIFTS, JUMP)))[::2])
def test_drifts_and_a_jump_of_one_encoder_add_up_in_any_order(faults):
    rig = accelerating(*faults, kinds.EncoderDrift(leg=4, by_m_s=-0.5))
    l, dl = motion(5)
    assert read(rig, 5) == pytest.approx((l + 3e-3 + 0.5 * 5e-3 + 0.25 * 4e-3, dl + 0.75), abs=1e-9)
    l, dl = motion(6)
    assert read(rig, 6, leg=4) == pytest.approx((l - 0.5 * 6e-3, dl - 0.5), abs=1e-9)


@pytest.mark.parametrize("lost_s", [2e-3, 3e-3])
def test_encoder_that_freezes_while_lost_later_reads_its_length_at_the_freeze(lost_s):
    frozen, lost = (
        kinds.EncoderFreeze(leg=3, at_s=3e-3),
        kinds.EncoderLost(leg=3, at_s=lost_s, for_s=5e-3 - lost_s),
    )
    rig = accelerating(frozen, lost)
    assert read(rig, 6, leg=3) == pytest.approx((motion(3)[0], 0.0), abs=1e-9)


def test_encoder_with_a_delay_fault_first_keeps_its_reading_and_then_follows_delayed():
    rig = accelerating(kinds.EncoderLate(leg=2, by_ms=3.0, at_s=2e-3))
    seen = [read(rig, t_ms) for t_ms in range(1, 9)]
    assert seen[0] == pytest.approx(motion(1))
    for early in seen[1:4]:
        assert early == pytest.approx(motion(2))
    for t_ms in range(5, 9):
        assert seen[t_ms - 1] == pytest.approx(motion(t_ms - 3))


def test_each_encoder_with_a_delay_fault_has_its_own_delay():
    rig = accelerating(kinds.EncoderLate(leg=2, by_ms=3.0), kinds.EncoderLate(leg=4, by_ms=1.0))
    for t_ms in range(7):
        found = rig.sync(t_ms * MS)
    for leg, late_ms in ((2, 3), (4, 1), (3, 0)):
        l, dl = motion(6 - late_ms)
        assert found["length"][leg] - REST[leg] == pytest.approx(l)
        assert found["rate"][leg] == pytest.approx(dl)


def test_encoder_noise_fault_is_white_with_the_given_standard_deviation_and_repeats_with_its_seed():
    def lengths(seed: int) -> Any:
        rig = Rig("ideal", faults=[kinds.EncoderNoise(leg=2, sigma_m=1e-3, seed=seed)])
        rig.configure()
        measured = [rig.sync(t * MS) for t in range(1, 1001)]
        assert all(m["rate"][2] == 0 and m["length"][3] == REST[3] for m in measured)
        return np.array([m["length"][2] for m in measured]) - REST[2]

    noise = lengths(1)
    assert abs(noise.mean()) < 5 * 1e-3 / 1000**0.5
    assert noise.std() == pytest.approx(1e-3, rel=5 / 2000**0.5)
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 5 / 1000**0.5
    np.testing.assert_array_equal(noise, lengths(1))
    assert (noise != lengths(2)).all()


def test_drive_with_a_lost_encoder_reports_the_loss_and_still_follows_commands():
    rig = Rig("ideal", faults=[kinds.EncoderLost(leg=1, at_s=3e-3)])
    rig.run(10 * MASS)
    measurement = rig.sync(8 * MS)
    assert measurement["blind"].tolist() == [False, True, False, False, False, False]
    assert (measurement["age"][1], measurement["drive_state"][1], measurement["drive_force"][1]) == (
        1_000_000,
        3,
        10 * MASS,
    )
    assert rig.nodes.snapshot().length[1] - REST[1] == pytest.approx(0.5 * 10 * 8e-3**2, abs=1e-12)


@pytest.mark.parametrize("reaction", [Reaction.HOLD, Reaction.DAMP])
def test_drive_with_a_lost_encoder_brakes_in_place_of_watchdog_reaction_damp_or_hold(reaction):
    rig = Rig("ideal", faults=[kinds.EncoderLost(leg=1, at_s=3e-3)], reaction=reaction)
    rig.run(10 * MASS)
    rig.at(50 * MS)
    assert rig.nodes.snapshot().fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert rig.nodes.snapshot().brake.tolist() == [0, 1, 0, 0, 0, 0]


def test_watchdog_reaction_hold_keeps_the_present_length_despite_an_earlier_encoder_slip():
    slips = [1e-3, -2e-3, 3e-3, -4e-3, 5e-3, -6e-3]
    rig = Rig(
        reaction=Reaction.HOLD, faults=[kinds.EncoderJump(leg=leg, by_m=by) for leg, by in enumerate(slips)]
    )
    rig.run()
    rig.at(50 * MS)
    snapshot = rig.nodes.snapshot()
    assert snapshot.fault.tolist() == [DriveFault.WATCHDOG] * 6
    assert snapshot.brake.tolist() == [0.0] * 6
    np.testing.assert_allclose(snapshot.length, REST, rtol=0, atol=1e-9)
