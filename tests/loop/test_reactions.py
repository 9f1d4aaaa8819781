"""Reactions to faults in motion, measured at the plant: the motion of each leg, and the holding force."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import DriveMode, Fault, Mode
from hil.app.check.command import inspect
from hil.app.configuration.configuration import load
from plant_fmu.faults.kinds import (
    BrakeStuckClosed,
    BrakeStuckOpen,
    DriveSign,
    DriveSilence,
    EncoderLost,
    WrenchStep,
)
from tests.broad import broad
from tests.loop.bench import changed, run

AT_s = 2.5
"""Time of the fault: on the book's path, in mid-motion, up to 1.1 m/s in a leg."""
END_s = 3.5
PUSH = WrenchStep(at_s=AT_s, force_N=(0, 0, -20_000), moment_N_m=(0, 0, 0))


@pytest.fixture(scope="module")
def bound_m():
    """The printed worst case: travel of a leg until its brake acts."""
    return inspect(load("virtual")).figures["reference"]["until_braked_m"]


def at_rest_with_the_brakes_commanded_shut(ran):
    still = ran.true[-200:]
    return np.abs(still - still[-1]).max() < 1e-5 and ran.rows["command_mode"][-300] == DriveMode.READY


@pytest.mark.parametrize(
    ("fault", "found"), [(PUSH, Fault.FOLLOWING), (DriveSign(leg=2, at_s=AT_s), Fault.DRIVE)]
)
def test_platform_with_excessive_following_error_is_braked_with_the_force_on(fault, found, bound_m):
    ran = run(load("virtual"), fault, stop_s=END_s)
    assert ran.ending.mode is Mode.PARKED, ran.ending
    assert ran.ending.faults & found
    assert not ran.ending.success
    assert ran.ending.fault_tick == ran.rows["tick"][ran.struck]
    assert ran.modes(ran.struck) == [Mode.PARKING, Mode.UNLOADING, Mode.PARKED]
    last = ran.rows[ran.rows["mode"] == Mode.PARKING][-1]
    refused = 1 << fault.leg if isinstance(fault, DriveSign) else 0
    assert last["legs_refused"] == refused
    powered = [leg for leg in range(6) if not refused >> leg & 1]
    assert np.abs(last["tau"][powered]).min() > 0, "the force is on until the brakes are proven"
    assert refused == 0 or last["tau"][fault.leg] == 0
    assert ran.moved(ran.struck) < bound_m


def test_platform_with_swapped_motor_wires_and_an_open_brake_on_another_leg_is_still_held(bound_m):
    faults = DriveSign(leg=2, at_s=AT_s), BrakeStuckOpen(leg=4, at_s=AT_s)
    ran = run(load("virtual"), *faults, stop_s=END_s)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.ending.faults & Fault.BRAKE
    assert "leg 4" in ran.ending.reason
    assert ran.moved(ran.struck) < bound_m
    assert at_rest_with_the_brakes_commanded_shut(ran)


@pytest.mark.parametrize(
    "fault", broad([EncoderLost(leg=0, at_s=AT_s), DriveSilence(leg=1, at_s=AT_s)], quick=1)
)
def test_leg_without_measurement_is_braked_and_keeps_its_force(fault, bound_m):
    ran = run(load("virtual"), fault, stop_s=END_s)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert f"leg {fault.leg}" in ran.ending.reason
    assert ran.moved(ran.struck) < bound_m
    assert at_rest_with_the_brakes_commanded_shut(ran)
    assert np.abs(ran.rows["tau"][-1]).min() > 0


def test_run_parks_after_a_silent_drive_returns_and_passes_its_brake_test(bound_m):
    ran = run(load("virtual"), DriveSilence(leg=1, at_s=AT_s, for_s=0.3), stop_s=END_s)
    assert ran.ending.mode is Mode.PARKED, ran.ending
    assert not ran.ending.success
    assert ran.ending.faults == Fault.STALE
    assert ran.modes(ran.struck) == [Mode.HELD, Mode.UNLOADING, Mode.PARKED]
    assert ran.cycle.proven
    assert ran.moved(ran.struck) < bound_m


def test_configured_reaction_to_a_following_error_decides_between_sto_and_ss1():
    """The same push: no force at once, or a controlled stop."""
    off = run(changed("virtual", reactions={"following": "sto"}), PUSH, stop_s=END_s)
    assert off.ending.mode is Mode.FAULT
    assert not off.rows["tau"][off.rows["mode"] == Mode.FAULT].any()
    soft = run(changed("virtual", reactions={"following": "ss1"}), PUSH, stop_s=END_s)
    assert soft.ending.mode is Mode.PARKED
    assert Mode.STOPPING in soft.modes()


def test_controlled_stop_after_a_lyapunov_alarm_stays_on_the_path_and_parks():
    """A violated certificate is no reason to brake hard."""
    c = changed(
        "virtual",
        monitor={"action": "fault", "disturbance_m_s2": 0.05},
        plant={"model": {"force_bandwidth_Hz": 60}},
    )
    ran = run(c, WrenchStep(at_s=AT_s, force_N=(0, 0, -2_000), moment_N_m=(0, 0, 0)), stop_s=END_s)
    assert ran.ending.faults == Fault.CERTIFICATE
    assert ran.ending.mode is Mode.PARKED
    assert ran.modes(ran.struck) == [Mode.STOPPING, Mode.PARKING, Mode.UNLOADING, Mode.PARKED]
    after = ran.rows[ran.struck :]
    stopping = after[after["mode"] == Mode.STOPPING]
    assert np.abs(stopping["q"] - stopping["q_d"]).max() < 10e-3
    assert np.abs(stopping["dq"][-1]).max() < 5e-3


@pytest.mark.parametrize(("leg", "fast_m_s"), [(2, 1.0), (4, 0.7)])
def test_brake_that_closes_in_motion_is_detected_while_all_legs_are_near_the_path(leg, fast_m_s, bound_m):
    """Most of the motion comes from the speed of the platform on its path, while five brakes close: 30 ms."""
    at_s, close_s = 1.69, 0.03
    ran = run(load("virtual"), BrakeStuckClosed(leg=leg, at_s=at_s), stop_s=END_s)
    begun, struck = round(1e3 * at_s), ran.struck
    assert ran.ending.mode in {Mode.HELD, Mode.PARKED}
    assert f"leg {leg}" in ran.ending.reason
    assert struck - begun < 60
    off = np.abs(ran.true[begun:struck] - ran.rows["q_d"][begun:struck]).max()
    allowed = 0.01 + 0.01 * np.abs(ran.rows["dq_d"][begun:struck, leg]).max()
    assert off < allowed + 1e-4, "no farther off the path than a following error is"
    speed = np.abs(np.diff(ran.true, axis=0)).max(axis=1) * 1e3
    assert speed[struck] > fast_m_s
    closing_m = np.abs(ran.true[struck + round(1e3 * close_s)] - ran.true[struck]).max()
    assert closing_m == pytest.approx(speed[struck] * close_s, rel=0.1)
    assert 2 * closing_m > ran.moved(struck), "the other half and less on the closed brakes"
    assert ran.moved(struck) < bound_m
    assert at_rest_with_the_brakes_commanded_shut(ran) or ran.ending.mode is Mode.PARKED
