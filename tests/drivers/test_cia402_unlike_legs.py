"""CiA 402 drives of unlike legs: what each may give, and what a loss of one direction alone takes."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from drivers.cia402 import objects as o
from drivers.cia402.states import State
from drivers.config import BusSettings, DriveSettings
from drivers.frame_array import received_array
from drivers.protocol import Frame, Received
from drivers.registry import loaded
from drivers.signals import LEGS, Command, DriveMode
from drivers.tick_columns import new_record
from hil.contracts.by_value import ByValue
from hil.contracts.ends import SETUP, Ends
from tests.drivers.cia402_drives import PERMILLE_N, STEP_m, drives, settings

SIGN = (1, -1, 1, -1, 1, 1)
LOSSES = [(0.8, 1.0), (1.0, 0.5)]
"""Efficiency, back-driving efficiency."""


def but(leg, value, others=1.0):
    """Return the six with another value of one leg."""
    return [value if each == leg else others for each in range(LEGS)]


def written(protocol, key):
    """Return what the start-up dialogue writes into an object of each drive."""
    plans = protocol.plans(SETUP)
    return [step.value for plan in plans for step in plan if (step.kind, step.key) == ("write", key)]


@pytest.mark.parametrize("leg", range(LEGS))
@pytest.mark.parametrize(
    ("quantity", "value", "others"),
    [
        ("lead_m", 0.04, 0.02),
        ("lead_m", 0.02, 0.005),
        ("gear_ratio", 0.5, 1.0),
        ("gear_ratio", 1.0, 3.0),
        ("efficiency", 0.5, 1.0),
    ],
)
def test_the_drive_of_the_weakest_leg_may_give_the_rated_force(quantity, value, others, leg):
    protocol = drives(**{quantity: but(leg, value, others)})
    # 10 kN of a leg that has PERMILLE_N = 2.827 N a permille, or half of it
    weakest_N = (
        PERMILLE_N if (quantity, others) in (("lead_m", 0.005), ("gear_ratio", 3.0)) else PERMILLE_N / 2
    )
    assert written(protocol, o.MAX_TORQUE) == [int(10_000 / weakest_N) + 1] * LEGS


@pytest.mark.parametrize("leg", range(LEGS))
def test_each_drive_is_asked_for_the_counts_of_its_own_leg(leg):
    counts = but(leg, 4096, others=10_000)
    plans = drives(counts_per_turn=counts).plans(SETUP)
    asked = [[s.value for s in plan if (s.kind, s.key) == ("read", (0x608F, 1))] for plan in plans]
    assert asked == [[each] for each in counts]


def test_drives_whose_encoders_are_unlike_are_all_set_up():
    ends = Ends(drives(counts_per_turn=[10_000, 10_000, 10_000, 4096, 4096, 4096]))
    ends.until_set_up()
    assert ends.nodes._drives.seen.configured.tolist() == [True] * LEGS


@pytest.mark.parametrize("force_limit_N", [500.0, 60_000.0])
def test_the_drives_own_limit_is_that_of_the_configured_rated_force(force_limit_N):
    found = DriveSettings(
        protocol="cia402",
        options={"rated_torque_Nm": 9.0},
        transmission=settings(),
        force_limit_N=force_limit_N,
    )
    protocol = loaded("hil.protocols", "cia402")(BusSettings(layout="classic"), found)
    assert written(protocol, o.MAX_TORQUE) == [int(force_limit_N / PERMILLE_N) + 1] * LEGS


def torques(protocol, force, rate):
    """Return what drives in Operation Enabled are sent, permille, without the signs of the legs."""
    dialogue = protocol.start(SETUP)._replace(states=(State.ENABLED,) * LEGS, rate=(rate,) * LEGS)
    _, frames = protocol.command(dialogue, Command(DriveMode.RUN, np.full(LEGS, force)), 1)
    return [sign * struct.unpack("<Hh", frame.data)[1] for sign, frame in zip(SIGN, frames, strict=False)]


def forces(protocol, permille, rate):
    """Return the forces that are read of drives that say this torque, without their signs, at this rate."""
    frames = []
    for node, sign in enumerate(SIGN, 1):
        place = struct.pack("<Hih", 0x0237, 0, sign * permille)
        speed = struct.pack("<i", sign * round(rate / STEP_m))
        frames += [Frame(0x180 + node, place), Frame(0x280 + node, speed)]
    tick = new_record()
    tick["tick"] = 0
    run = received_array([Received(1, frame) for frame in frames])
    protocol.decode(protocol.start(SETUP), run, new_record(), tick, 0)
    assert tick["age"].tolist() == [0] * LEGS
    return tick["drive_force"]


@pytest.mark.parametrize(("driving", "back"), LOSSES)
@pytest.mark.parametrize("side", [1, -1])
def test_a_loss_of_one_direction_alone_is_made_up_for_in_that_direction(driving, back, side):
    protocol = ByValue(drives(efficiency=driving, back_driving_efficiency=back))
    lossless = 1000.0 / PERMILLE_N
    assert torques(protocol, side * 1000.0, side * 0.1) == [side * round(lossless / driving)] * LEGS
    assert torques(protocol, side * 1000.0, side * -0.1) == [side * round(lossless * back)] * LEGS


@pytest.mark.parametrize(("driving", "back"), LOSSES)
@pytest.mark.parametrize("side", [1, -1])
def test_a_loss_of_one_direction_alone_is_taken_from_the_force_that_is_read(driving, back, side):
    protocol = ByValue(drives(efficiency=driving, back_driving_efficiency=back))
    lossless = side * 400 * PERMILLE_N
    np.testing.assert_allclose(forces(protocol, side * 400, side * 0.1), lossless * driving, rtol=1e-12)
    np.testing.assert_allclose(forces(protocol, side * 400, side * -0.1), lossless / back, rtol=1e-12)


@pytest.mark.parametrize("leg", range(LEGS))
def test_a_loss_of_one_leg_alone_is_that_of_its_leg(leg):
    for changes, rate, share in (
        ({"efficiency": but(leg, 0.8)}, 0.1, 0.8),
        ({"back_driving_efficiency": but(leg, 0.5)}, -0.1, 2.0),
    ):
        protocol = ByValue(drives(**changes))
        expected = [round(1000.0 / PERMILLE_N / each) for each in but(leg, share)]
        assert torques(protocol, 1000.0, rate) == expected
        read = 400 * PERMILLE_N * np.array(but(leg, share))
        np.testing.assert_allclose(forces(protocol, 400, rate), read, rtol=1e-12)


def test_the_ends_of_a_position_of_32_bits_are_the_shortest_and_the_longest_length_of_either_sign():
    """2^31 counts of 2^17 a turn are 2^14 turns of 20 mm; the upper end is a count less."""
    shortest, longest = drives().traits.reported_lengths
    for leg, (sign, offset_m) in enumerate(zip(SIGN, (0.75, 0.75, 0.75, 0.75, 0.75, 0.5), strict=True)):
        less = (0.0, STEP_m) if sign > 0 else (STEP_m, 0.0)
        assert shortest[leg] == pytest.approx(offset_m - 327.68 + less[0], rel=0, abs=0.1 * STEP_m)
        assert longest[leg] == pytest.approx(offset_m + 327.68 - less[1], rel=0, abs=0.1 * STEP_m)
