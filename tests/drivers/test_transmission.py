"""Motor to leg and back, against numbers calculated by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.config import TransmissionSettings
from drivers.transmission import Transmission, forgotten_length

SCREW = {"lead_m": 0.005, "gear_ratio": 2.0, "efficiency": 0.8, "back_driving_efficiency": 0.6}
SIX = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


def six(**values: object) -> Transmission:
    return Transmission(TransmissionSettings.model_validate(values))


def all_legs(value: float) -> np.ndarray:
    return np.full(6, value)


def test_screw_of_5_mm_lead_with_a_gear_of_2_moves_its_leg_2_5_mm_per_motor_turn():
    t = six(**SCREW, offset_m=0.3)
    np.testing.assert_allclose(t.length(all_legs(0.1)), 0.30025, rtol=1e-15)
    np.testing.assert_allclose(t.rate(all_legs(4.0)), 0.01, rtol=1e-15)
    np.testing.assert_allclose(t.turns(all_legs(0.31)), 4.0, rtol=1e-12)


def test_negative_transmission_sign_reverses_motion_and_force_but_not_the_length_offset():
    t = six(**SCREW, offset_m=0.3, sign=[1, -1, 1, -1, 1, -1])
    np.testing.assert_allclose(t.length(all_legs(2.0)), [0.305, 0.295] * 3, rtol=1e-15)
    np.testing.assert_allclose(t.rate(all_legs(2.0)), [0.005, -0.005] * 3, rtol=1e-15)
    np.testing.assert_allclose(t.torque(all_legs(10.0)), [0.003978873577297384, -0.003978873577297384] * 3)


def test_leg_force_of_a_transmission_without_losses_follows_from_virtual_work():
    # 1 N m x 2 pi x 2 / 5 mm = 2513.27 N; a pulley of 20 mm radius: 1 N m / 20 mm = 50 N.
    np.testing.assert_allclose(six(lead_m=0.005, gear_ratio=2).force(all_legs(1.0)), 2513.2741228718346)
    np.testing.assert_allclose(six(pulley_radius_m=0.02).force(all_legs(1.0)), 50.0, rtol=1e-14)
    np.testing.assert_allclose(six(pulley_radius_m=0.02).length(all_legs(1.0)), 0.12566370614359174)


@pytest.mark.parametrize(
    ("force", "rate", "torque"),
    [
        # 100 N x 5 mm / (2 pi x 2) = 39.789 mN m without losses
        (100.0, 0.0, 0.03978873577),
        (100.0, 0.05, 0.04973591972),  # the motor lifts: / 0.8
        (100.0, -0.05, 0.02387324146),  # the load drives: x 0.6
        (-100.0, -0.05, -0.04973591972),
        (-100.0, 0.05, -0.02387324146),
        (100.0, 0.0005, 0.04476232774),  # half of the rate of full loss: 1 + 0.25 / 2
        (100.0, -0.0005, 0.03183098862),  # 1 - 0.4 / 2
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_transmission_loss_increases_driving_and_reduces_back_driven_torque(force, rate, torque, sign):
    t = six(**SCREW, sign=sign)
    np.testing.assert_allclose(t.torque(all_legs(force), all_legs(rate)), sign * torque, rtol=1e-9)
    np.testing.assert_allclose(t.force(all_legs(sign * torque), all_legs(rate)), force, rtol=1e-9)


def test_range_of_motor_turns_gives_the_shortest_and_longest_leg_lengths():
    t = six(lead_m=SIX, gear_ratio=2.0, offset_m=SIX, sign=[1, -1] * 3)
    shortest, longest = t.lengths_within(0.5)
    np.testing.assert_allclose(shortest, 0.75 * np.array(SIX), rtol=1e-14)
    np.testing.assert_allclose(longest, 1.25 * np.array(SIX), rtol=1e-14)


@pytest.mark.parametrize("turns", [0.5, [0.5] * 6, SIX])
def test_length_lost_by_forgotten_encoder_turns_is_positive_for_either_sign(turns):
    settings = TransmissionSettings.model_validate({"lead_m": SIX, "gear_ratio": 2.0, "sign": [1, -1] * 3})
    expected = np.array(SIX) / 2.0 * np.array(turns)
    np.testing.assert_allclose(forgotten_length(settings, turns), expected, rtol=1e-14)


EDGES = [0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 1e-3, -1e-3, 5e-324, -5e-324]
any_number = st.floats(allow_nan=False) | st.sampled_from(EDGES)
six_numbers = st.lists(any_number, min_size=6, max_size=6)
six_shares = st.lists(st.floats(0.01, 1.0), min_size=6, max_size=6)


@given(
    six_numbers, st.lists(st.floats(-3e-3, 3e-3) | any_number, min_size=6, max_size=6), six_shares, six_shares
)
def test_compiled_transmission_losses_equal_the_formula_to_the_last_bit(force, rate, eta_d, eta_b):
    t = six(**SCREW | {"efficiency": eta_d, "back_driving_efficiency": eta_b}, sign=[1, -1] * 3)
    given_N, dq, driving, back = np.array(force), np.array(rate), np.array(eta_d), np.array(eta_b)

    def bits(row: np.ndarray) -> bytes:
        # the sign of a NaN that two NaNs give is the processor's choice
        return np.where(np.isnan(row), np.nan, row).tobytes()

    def loss(f0: np.ndarray) -> np.ndarray:
        w: np.ndarray = np.sign(f0) * np.minimum(np.maximum(dq / 1e-3, -1.0), 1.0)
        return 1.0 + np.where(w > 0.0, w * (1.0 / driving - 1.0), w * (1.0 - back))

    with np.errstate(all="ignore"):
        torque = loss(given_N) * given_N / t.N_per_Nm
        assert bits(t.torque(given_N, dq)) == bits(torque)
        lossless = t.N_per_Nm * torque
        assert bits(t.force(torque, dq)) == bits(lossless / loss(lossless))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({}, "given: neither"),
        ({"lead_m": 0.005, "pulley_radius_m": 0.02}, "given: lead_m and pulley_radius_m"),
        ({"lead_m": 0.005, "back_driving_efficiency": 0.0}, "greater than 0"),
    ],
)
def test_invalid_transmission_is_refused(wrong, message):
    with pytest.raises(ValidationError, match=message):
        TransmissionSettings.model_validate(wrong)
