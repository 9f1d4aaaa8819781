"""What holds a platform whose measurement or brakes are no longer believed: the force that held it before."""

from __future__ import annotations

import numpy as np
import pytest

import hil.loop.cycle
from drivers.signals import DriveState, Fault, Mode
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.kinematics import jacobian
from plant_fmu.faults.kinds import (
    BrakeStuckOpen,
    DriveSilence,
    EncoderDrift,
    EncoderJump,
    EncoderLost,
    FramesForgedCommand,
    WrenchStep,
)
from tests.broad import broad
from tests.loop import test_fusion as fusion
from tests.loop.test_held import BOUND_m, configuration, held, run

JUMP_s = 2.0
"""On the book's path, in mid-motion."""
BRAKES_m = 0.05
"""Six brakes stop the platform from there within 24 mm."""
SOME = [(0, 0.1), (3, 0.12), (2, 0.3), (5, -0.1)]
"""Legs and jumps, m. Statics at the pose of the first ask for 50 kN on one leg."""
ALL = [(leg, by) for leg in range(6) for by in (-0.5, -0.2, -0.05, 0.05, 0.1, 0.15, 0.25, 0.5)]
LOAD_s, SECOND_s = 0.4, 0.7
"""After UNLOADING has begun."""
ALONG = 3
"""A leg whose brake does not close."""


def after_the_fault(ran):
    return ran.moved(int(np.argmax(ran.rows["faults"] != 0)))


def along(leg, force_N):
    """Return a load along one leg at home, which comes when the platform is held."""
    c = load("virtual")
    w = jacobian(build_platform(c.platform), *pose_arrays(c.platform.home))[leg] * force_N
    return WrenchStep(mode="UNLOADING", at_s=LOAD_s, force_N=tuple(w[:3]), moment_N_m=tuple(w[3:]))


@pytest.mark.parametrize(
    ("leg", "by"), [*SOME, *(pytest.param(*case, marks=pytest.mark.long) for case in ALL)]
)
def test_a_jump_of_any_size_does_not_aim_the_holding_force(leg, by):
    ran = run(load("virtual"), EncoderJump(leg=leg, at_s=JUMP_s, by_m=by), duration_s=3.0)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.ending.faults & Fault.ENCODER
    assert after_the_fault(ran) < BRAKES_m
    tau = ran.rows["tau"]
    assert np.abs(tau[-1]).max() < 1.2 * np.abs(tau[: round(1e3 * JUMP_s)]).max()


@pytest.mark.parametrize(("leg", "by"), broad([(0, 0.1), (5, -0.1)], quick=1))
def test_nor_does_the_load_that_an_observer_sees_in_the_jump(leg, by):
    """The observer takes the jump for a blow on the platform: what it thought a tick before still holds."""
    c = load("virtual")
    observer = (
        "\nestimation: {wrench: {source: observer, bandwidth_Hz: 100, bus_ms: 0.5, drive_lag_ms: 0.796}}\n"
    )
    ran = run(
        loads(c.text + observer, c.name, c.folder), EncoderJump(leg=leg, at_s=JUMP_s, by_m=by), duration_s=3.0
    )
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert after_the_fault(ran) < BRAKES_m
    tau = ran.rows["tau"]
    assert np.abs(tau[-1]).max() < 1.2 * np.abs(tau[: round(1e3 * JUMP_s)]).max()


def test_a_drifting_encoder_of_a_held_platform_does_not_push_its_brake_open():
    """Faster than with 5 mm/s nothing would end: after 6 s it reads 90 mm, and the brakes bear 20 kN."""
    lockstep, plant, course = held(EncoderDrift(leg=0, at_s=2.0, by_m_s=0.018))
    cycle, nodes = lockstep.cycle, lockstep.nodes
    try:
        before, tau = nodes.snapshot().length.copy(), cycle.effort.holding.copy()
        for _ in range(6000):
            lockstep.step(course.commands(lockstep.tick + 1))
            assert course.ending(lockstep.tick) is None
        assert cycle.tick["length"][0] - nodes.snapshot().length[0] > 0.09
        assert np.abs(nodes.snapshot().length - before).max() < 50e-6
        assert np.abs(cycle.effort.last_tau - tau).max() <= load("virtual").limits.force_window_N + 1e-6
    finally:
        plant.close()


@pytest.mark.parametrize("force_N", broad([-5_000, 5_000], quick=1))
def test_a_load_along_a_leg_whose_brake_is_known_to_be_open_is_held_by_its_drive(force_N):
    """Nobody takes it for a drive that does not obey: what holds that leg is its force alone."""
    faults = BrakeStuckOpen(leg=ALONG, mode="PARKING"), along(ALONG, force_N)
    ran = run(load("virtual"), *faults, duration_s=2.0)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert not ran.rows["legs_refused"].any()
    loaded = ran.true[ran.first(Mode.UNLOADING) + round(1e3 * LOAD_s) :]
    assert len(loaded) > 200, "the load has come"
    assert np.abs(loaded - loaded[0]).max() < 0.05


@pytest.mark.parametrize(
    "second",
    [
        EncoderJump(leg=1, mode="UNLOADING", at_s=SECOND_s, by_m=5e-3),
        DriveSilence(leg=1, mode="UNLOADING", at_s=SECOND_s),
    ],
)
def test_a_measurement_that_is_lost_while_the_law_holds_leaves_the_force_it_had(second):
    stuck = BrakeStuckOpen(leg=ALONG, mode="PARKING")
    push = WrenchStep(mode="UNLOADING", at_s=LOAD_s, force_N=(0, 0, -5_000), moment_N_m=(0, 0, 0))
    ran = run(load("virtual"), stuck, push, second, duration_s=2.0)
    assert ran.ending.mode is Mode.HELD
    struck = ran.first(Mode.UNLOADING) + round(1e3 * SECOND_s)
    assert len(ran.rows) > struck + 100, "it has struck"
    before, after = ran.rows["tau"][struck - 1], ran.rows["tau"][-1]
    np.testing.assert_allclose(after, before, atol=300.0)
    assert ran.moved(struck) < BOUND_m


def test_legs_that_never_come_to_rest_are_braked_whatever_the_table_says(monkeypatch):
    """A stop that is followed by a stop would never end."""
    monkeypatch.setattr(hil.loop.cycle, "REST_m_s", -1.0)
    c = configuration("virtual", ("following: sbc                     #", "following: ss1  #"))
    ran = run(c, duration_s=2.0)
    assert ran.ending.mode in {Mode.PARKED, Mode.HELD}
    assert ran.ending.faults == Fault.FOLLOWING
    mode = ran.rows["mode"]
    stops = np.flatnonzero((mode[1:] == Mode.STOPPING) & (mode[:-1] != Mode.STOPPING))
    assert len(stops) == 1


def test_six_encoders_without_a_length_are_no_silent_drives():
    """One supply for all encoders: the drives answer and obey, so the force stays."""
    ran = run(load("virtual"), *(EncoderLost(leg=leg, at_s=2.0) for leg in range(6)), duration_s=4.0)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.ending.faults & Fault.STALE
    assert "invalid" in ran.ending.reason
    assert np.abs(ran.rows["tau"][-1]).min() > 0


@pytest.mark.long
def test_a_leg_without_encoder_proves_no_brake_although_the_pose_is_known():
    """The filter takes a platform on shut brakes to stand: it may not be asked."""
    ran = run(fusion.bench(), EncoderLost(leg=2, at_s=0.8), duration_s=1.6)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert not ran.cycle.proven
    assert ran.ending.faults & Fault.STALE
    assert "leg 2" in ran.ending.reason
    assert np.abs(ran.rows["tau"][-1]).min() > 0
    assert ran.moved(ran.first(Mode.PARKING)) < BOUND_m


@pytest.mark.parametrize("mode", ["IDLE", "PARKED"])
def test_who_powers_the_drives_without_consent_is_met_with_an_emergency_stop(mode):
    """The forger is heard before us in every tick, so OFF is the second command and is refused."""
    forger = FramesForgedCommand(mode=mode, at_s=0.0, force_N=6000.0)
    ran = run(load("virtual"), forger, duration_s=2.0)
    struck = int(np.argmax(ran.rows["faults"] != 0))
    assert ran.ending.faults & Fault.SECOND_CONTROLLER
    assert (ran.rows["drive_state"][struck + 5 :] != DriveState.RUN).all()
    assert ran.moved(struck) < 1e-4
