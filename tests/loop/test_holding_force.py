"""Force on a platform with untrusted measurement or brakes: the last force that held it."""

from __future__ import annotations

import numpy as np
import pytest

import hil.loop.cycle
from drivers.signals import DriveState, Fault, Mode
from hil.app.configuration.configuration import load
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
from tests.loop.bench import changed, run
from tests.loop.fusion_runs import fused
from tests.loop.test_brake_faults import BOUND_m, held

JUMP_s = 2.0
"""Time of the jump: on the book's path, in mid-motion."""
BRAKES_m = 0.05
"""Bound of the motion: from there six brakes stop the platform within 24 mm."""
OBSERVER = {"wrench": {"source": "observer", "bandwidth_Hz": 100, "bus_ms": 0.5, "drive_lag_ms": 0.796}}
SIZES = (-0.5, -0.2, -0.05, 0.05, 0.1, 0.15, 0.25, 0.5)
JUMPS = [
    (0, 0.1, None), (3, 0.12, None), (2, 0.3, None), (5, -0.1, None), (0, 0.1, OBSERVER), (5, -0.1, OBSERVER),
    *((leg, by, None) for n, by in enumerate(SIZES) for leg in (n % 6, (n + 3) % 6)),
]  # fmt: skip
"""Legs and jumps, m. Statics at the first measured pose would ask for 50 kN on one leg. An observer
interprets the jump as a blow on the platform: its estimate of the tick before stays valid."""
LOAD_s, SECOND_s = 0.4, 0.7
"""Times since the start of UNLOADING."""
ALONG = 3
"""A leg whose brake does not close."""


@pytest.mark.parametrize(("leg", "by", "estimation"), broad(JUMPS, quick=5))
def test_encoder_jump_does_not_change_the_force_that_holds_the_platform(leg, by, estimation):
    c = changed("virtual", estimation=estimation) if estimation else load("virtual")
    ran = run(c, EncoderJump(leg=leg, at_s=JUMP_s, by_m=by), stop_s=3.0)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.ending.faults & Fault.ENCODER
    assert ran.moved(ran.struck) < BRAKES_m
    tau = ran.rows["tau"]
    assert np.abs(tau[-1]).max() < 1.2 * np.abs(tau[: round(1e3 * JUMP_s)]).max()


def test_drifting_encoder_of_a_held_leg_does_not_raise_its_force_against_the_closed_brake():
    """With a drift above 5 mm/s nothing would end the run: after 6 s the encoder reads 90 mm, and the brakes
    hold 20 kN.
    """
    with held(EncoderDrift(leg=0, at_s=2.0, by_m_s=0.018)) as (lockstep, course):
        cycle, nodes = lockstep.cycle, lockstep.nodes
        before, tau = nodes.snapshot().length.copy(), cycle.effort.holding.copy()
        for _ in range(6000):
            lockstep.step(course.commands(lockstep.tick + 1))
            assert course.ending(lockstep.tick) is None
        assert cycle.tick["length"][0] - nodes.snapshot().length[0] > 0.09
        assert np.abs(nodes.snapshot().length - before).max() < 50e-6
        assert np.abs(cycle.effort.last_tau - tau).max() <= load("virtual").limits.force_window_N + 1e-6


@pytest.mark.parametrize("force_N", broad([-5_000, 5_000], quick=1))
def test_drive_that_alone_holds_a_loaded_leg_with_an_open_brake_does_not_count_as_disobedient(force_N):
    """This is not a drive that disobeys: only its own force holds that leg."""
    c = load("virtual")
    w = jacobian(build_platform(c.platform), *pose_arrays(c.platform.home))[ALONG] * force_N
    load_along = WrenchStep(mode="UNLOADING", at_s=LOAD_s, force_N=tuple(w[:3]), moment_N_m=tuple(w[3:]))
    ran = run(c, BrakeStuckOpen(leg=ALONG, mode="PARKING"), load_along, stop_s=2.0)
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
def test_holding_force_stays_at_its_last_value_when_a_leg_measurement_is_lost(second):
    stuck = BrakeStuckOpen(leg=ALONG, mode="PARKING")
    push = WrenchStep(mode="UNLOADING", at_s=LOAD_s, force_N=(0, 0, -5_000), moment_N_m=(0, 0, 0))
    ran = run(load("virtual"), stuck, push, second, stop_s=2.0)
    assert ran.ending.mode is Mode.HELD
    struck = ran.first(Mode.UNLOADING) + round(1e3 * SECOND_s)
    assert len(ran.rows) > struck + 100, "the fault has struck"
    np.testing.assert_allclose(ran.rows["tau"][-1], ran.rows["tau"][struck - 1], atol=300.0)
    assert ran.moved(struck) < BOUND_m


def test_legs_that_never_come_to_rest_in_a_stop_are_braked_under_any_configured_reaction(monkeypatch):
    """Without the rule a stop would follow a stop for ever."""
    monkeypatch.setattr(hil.loop.cycle, "REST_m_s", -1.0)
    ran = run(changed("virtual", reactions={"following": "ss1"}), stop_s=2.0)
    assert ran.ending.mode in {Mode.PARKED, Mode.HELD}
    assert ran.ending.faults == Fault.FOLLOWING
    mode = ran.rows["mode"]
    assert np.count_nonzero((mode[1:] == Mode.STOPPING) & (mode[:-1] != Mode.STOPPING)) == 1


def test_six_invalid_encoders_do_not_count_as_silent_drives():
    """All encoders share one supply: the drives answer and obey, so the force stays on."""
    ran = run(load("virtual"), *(EncoderLost(leg=leg, at_s=2.0) for leg in range(6)), stop_s=4.0)
    assert ran.ending.mode is Mode.HELD, ran.ending
    assert ran.ending.faults & Fault.STALE
    assert "invalid" in ran.ending.reason
    assert np.abs(ran.rows["tau"][-1]).min() > 0


@pytest.mark.long
def test_brake_test_of_a_leg_without_encoder_is_not_passed_by_its_fused_pose():
    """The filter assumes that a platform on shut brakes stands, so its estimate cannot prove a brake."""
    ran = run(fused(), EncoderLost(leg=2, at_s=0.8), stop_s=1.6)
    assert (ran.ending.mode, ran.cycle.proven) == (Mode.HELD, False)
    assert ran.ending.faults & Fault.STALE
    assert "leg 2" in ran.ending.reason
    assert np.abs(ran.rows["tau"][-1]).min() > 0
    assert ran.moved(ran.first(Mode.PARKING)) < BOUND_m


@pytest.mark.parametrize("mode", ["IDLE", "PARKED"])
def test_drives_powered_by_a_forged_command_before_arm_or_after_parking_cause_an_emergency_stop(mode):
    """The forged command comes before ours in every tick, so OFF is the second command and is refused."""
    ran = run(load("virtual"), FramesForgedCommand(mode=mode, at_s=0.0, force_N=6000.0), stop_s=2.0)
    assert ran.ending.faults & Fault.SECOND_CONTROLLER
    assert (ran.rows["drive_state"][ran.struck + 5 :] != DriveState.RUN).all()
    assert ran.moved(ran.struck) < 1e-4
