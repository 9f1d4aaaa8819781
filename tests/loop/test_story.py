"""Faults in whole simulated runs: leg, value and limit of the story match the plant, and the log contains it."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.signals import Command, DriveMode, Fault, Mode
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import load
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.loop.run_end import Course
from hil.loop.story.story import Story
from hil.record.log import Log
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.kinds import (
    DriveSign,
    DriveSilence,
    EncoderLost,
    FramesLoss,
    PlantCrash,
    PlantNaN,
)
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad
from tests.drivers.legs_frames import command_frames
from tests.loop.bench import Ran, changed, new_cycle, run, until
from tests.loop.test_attacks import Attacked

STOP_S = 2.0
SWAPPED = DriveSign(leg=3, at_s=1.6)


def story_of(ran: Ran) -> Story:
    assert ran.ending.story is not None
    return ran.ending.story


def told(*faults: PlantFault, **sections: Any) -> tuple[Ran, Story]:
    """Run with faults; return the run and its story."""
    ran = run(changed("virtual", **sections), *faults, stop_s=STOP_S)
    return ran, story_of(ran)


def test_swapped_motor_wires_are_reported_with_leg_and_tracking_error():
    ran, story = told(SWAPPED)
    finding, cause = story.findings
    assert (cause.fault, cause.leg) == ("DRIVE", 3)
    row, true = ran.rows[finding.tick], ran.true[finding.tick]
    error = np.abs(row["q_d"] - true)
    assert (finding.fault, finding.leg) == ("FOLLOWING", int(error.argmax())) == ("FOLLOWING", 3)
    assert finding.value == pytest.approx(error[3], abs=2e-4)
    assert finding.limit == pytest.approx(0.01 + 0.01 * abs(row["dq_d"][3]))
    assert ran.rows[finding.tick - 1]["faults"] == 0
    assert row["faults"] == Fault.FOLLOWING
    assert finding.time_s == pytest.approx(1e-3 * finding.tick)
    assert f"leg 3 is {1e3 * finding.value:.2f} mm" in ran.ending.trouble  # type: ignore[operator]
    assert "all six in OFF" in ran.ending.trouble


@pytest.mark.parametrize("leg", broad((4, 1, 0, 2, 3, 5), quick=1))
def test_silent_drive_is_reported_with_the_periods_since_its_last_frame(leg):
    ran, story = told(DriveSilence(leg=leg, at_s=1.4))
    (finding,) = story.findings
    assert (finding.fault, finding.value, finding.limit, finding.leg, finding.tick) == (
        "STALE",
        5,
        5,
        leg,
        1400 + 4,
    )
    assert ran.ending.trouble.endswith(f"not confirmed by drive {leg}")


@pytest.mark.parametrize(
    ("fault", "leg", "unconfirmed"),
    [(EncoderLost(leg=1, at_s=1.4), 1, False), (FramesLoss(at_s=1.4), None, True)],
)
def test_report_of_a_lost_encoder_differs_from_that_of_lost_frames(fault, leg, unconfirmed):
    _, story = told(fault)
    (finding,) = story.findings
    assert (finding.fault, finding.leg) == ("STALE", leg)
    assert ("not confirmed by drive 0, 1, 2, 3, 4, 5" in story.done_text) is unconfirmed
    assert "all six" not in story.done_text or not unconfirmed


def test_drives_switched_off_by_a_command_the_controller_did_not_send_are_reported():
    """Behind a gateway the controller does not receive the forged command."""
    c = load("virtual")
    nodes, plant = build_nodes(c)
    attacked = Attacked(new_cycle(c), nodes, (BitTiming.of(c.bus),), c.loop.window_s(1000.0))
    course = Course(attacked.cycle)
    until(attacked, Mode.APPROACH, course)
    attacked.audible = False
    protocol, off = attacked.cycle.parts.protocol, Command(DriveMode.OFF, np.zeros(6))
    attacked.attack = lambda tick: command_frames(protocol, off, tick)
    ending = None
    while ending is None:
        attacked.step(course.commands(attacked.tick + 1))
        ending = course.ending(attacked.tick)
    plant.close()
    assert ending.story is not None
    found = [(each.fault, each.leg, each.value) for each in ending.story.findings]
    assert found == [("DRIVE", leg, "OFF") for leg in range(6)]
    assert "drive 0, 1, 2, 3, 4, 5 in OFF instead of RUN" in ending.reason


@pytest.mark.long
def test_log_summary_and_replay_contain_the_same_explanation_of_a_fault(tmp_path):
    """With leg and value in machine-readable fields, in the tick of the fault and at the end."""
    path = tmp_path / "fault.mcap"
    summary = simulate(load("virtual"), log=path, faults=FaultPlan([SWAPPED]))
    story = summary["story"]
    assert not summary["success"]
    assert summary["replay"]["different_ticks"] == 0
    comparison, _ = replay_log(path)
    assert comparison.story is not None
    assert comparison.story.fields() == story
    log = Log.open(path)
    assert json.loads(log.metadata["summary"]["story"]) == story
    assert log.metadata["summary"]["reason"] == summary["trouble"]
    first, _, last = log.events()
    words, fields = first.text.split("\n")
    assert first.level == last.level == "error"
    assert first.t_ns == 1_000_000 * story["findings"][0]["tick"]
    assert json.loads(fields) == story["findings"][0]
    assert words == story["lines"][0]
    assert last.text == summary["trouble"]


PLANT_FAILS = [
    (PlantCrash(at_s=1.6), "the plant crashed"),
    (PlantNaN(at_s=1.6), "the plant gave no valid measurement"),
]


@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize(("fault", "words"), PLANT_FAILS)
def test_plant_failure_ends_the_run_and_an_earlier_fault_is_still_reported(fault, words, before, tmp_path):
    path = tmp_path / "plant.mcap"
    faults = [DriveSilence(leg=2, at_s=1.55), fault] if before else [fault]
    summary = simulate(load("virtual"), log=path, faults=FaultPlan(faults))
    story = summary["story"]
    assert not summary["success"]
    assert summary["trouble"].startswith(words)
    assert story["plant"].startswith(words)
    found = [(each["fault"], each["leg"], each["tick"]) for each in story["findings"]]
    assert found == ([("STALE", 2, 1554)] if before else [])
    assert ("latched fault STALE (leg 2" in summary["trouble"]) is before
    assert [step["mode"] for step in story["done"]] == ["HELD"] * before + ["PLANT"]
    assert any(line.startswith("plant: ") for line in story["lines"])
    assert before or {each["state"] for each in story["drives_at_end"]} == {"RUN"}
    metadata = Log.open(path).metadata["summary"]
    assert (metadata["reason"], metadata["story"]) == (summary["trouble"], json.dumps(story))


# -- each fault of the motion really happens -------------------------------------------------------------------

UP_AND_DOWN = {
    "type": "sinusoids",
    "duration_s": 10,
    "components": [{"axis": "z_m", "amplitude": 0.5, "frequency_Hz": 0.5}],
}
"""From 1 m: sqrt(1.24^2 + z^2) is 1.8 m at z = 1.305 m, 1.4 m at z = 0.65 m."""
SWINGING: dict[str, Any] = {
    "controller": {
        "kp_N_m": [1e5, 1.5e5, 2e5, 2.5e5, 3e5, 3.5e5],
        "kv_N_s_m": [350, 500, 650, 800, 950, 1100],
    },
    "engage": {"stop_s": 0.02},
    "limits": {"speed_m_s": 3, "following_error_m": 0.2},
}
"""Legs on springs with little damping, stopped within 20 ms, each with its own frequency."""


class Real(NamedTuple):
    """Conditions that cause a fault, and the log columns of each reported leg."""

    fault: Fault
    sections: dict[str, Any]
    duration_s: float
    value: Callable[[Any], Any]
    """From the row, as the rule defines it: (6,) per leg, or one number."""
    limit: Callable[[Any], Any]
    name: str = "virtual"


REAL = {
    "SPEED": Real(
        Fault.SPEED, {"limits": {"speed_m_s": 0.5}}, 2.0,
        lambda row: np.abs(row["dq"]), lambda row: np.full(6, 0.5),
    ),
    "STROKE, before the upper soft end": Real(
        Fault.STROKE, {"reference": UP_AND_DOWN, "platform": {"length_max_m": 1.8}}, 2.0,
        lambda row: row["dq"], lambda row: np.sqrt(2 * 10 * (1.78 - row["q"])),
    ),
    "STROKE, before the lower soft end": Real(
        Fault.STROKE, {"reference": UP_AND_DOWN, "platform": {"length_min_m": 1.4}}, 3.0,
        lambda row: -row["dq"], lambda row: np.sqrt(2 * 10 * (row["q"] - 1.42)),
    ),
    "STROKE, a hard end": Real(
        Fault.STROKE,
        {
            "reference": UP_AND_DOWN,
            "platform": {"length_max_m": 1.8},
            "limits": {"stroke_margin_m": 0, "deceleration_m_s2": 1e6},
        },
        2.0, lambda row: row["q"], lambda row: np.full(6, 1.8),
    ),
    "FOLLOWING, behind the reference": Real(
        Fault.FOLLOWING, {"limits": {"force_N": 5000}}, 2.0,
        lambda row: np.abs(row["q_d"] - row["q"]), lambda row: 0.01 + 0.01 * np.abs(row["dq_d"]),
    ),
    "FOLLOWING, not at rest": Real(
        Fault.FOLLOWING, SWINGING, 3.25, lambda row: np.abs(row["dq"]), lambda row: np.full(6, 0.02), "bench"
    ),
    "CONDITION": Real(
        Fault.CONDITION, {"limits": {"condition": 4}}, 2.5, lambda row: row["condition"], lambda row: 4.0
    ),
}  # fmt: skip


@pytest.mark.parametrize("real", broad(map(pytest.param, REAL.values()), quick=5), ids=REAL)
def test_fault_in_motion_is_reported_with_the_logged_value_and_its_limit(real):
    ran = run(changed(real.name, **real.sections), stop_s=real.duration_s)
    found = [each for each in story_of(ran).findings if each.fault == real.fault.name]
    row, before = (ran.rows[found[0].tick - n] for n in (0, 1))
    assert row["faults"] == real.fault
    assert before["faults"] == 0
    values, limits = (np.atleast_1d(each(row)) for each in (real.value, real.limit))
    named = [each.leg or 0 for each in found if each.tick == found[0].tick]
    assert named == np.flatnonzero(values > limits).tolist()
    for each in found[: len(named)]:
        leg = each.leg or 0
        assert each.value == pytest.approx(values[leg], rel=1e-12)
        assert each.limit == pytest.approx(limits[leg], rel=1e-9)
    if real.fault is not Fault.CONDITION:
        true = ran.true[found[0].tick]
        assert row["q"] == pytest.approx(true, abs=2e-3), "what was measured is where the legs are"


@pytest.mark.parametrize(
    ("begins", "speed", "raises"),
    [(0, -1.0, True), (1400, -1.0, True), (1400, 0.1, True), (1400, -1.0, False)],
)
def test_exception_or_nan_of_a_law_is_a_fault_reported_with_its_source_line(
    monkeypatch, begins, speed, raises
):
    """From the start, from a tick on, and only in motion: not when the law is evaluated for the holding
    force.
    """
    effort = JointInverseDynamics.effort

    def defective(self, tick):
        effort(self, tick)
        if tick["tick"] >= begins and abs(tick["dq"]).max() > speed:
            tick["tau_law"][3] = np.nan
            if raises:
                raise ZeroDivisionError("a {defect}")

    monkeypatch.setattr(JointInverseDynamics, "effort", defective)
    ran, story = told()
    (finding,) = story.findings
    struck = ~np.isfinite(ran.rows["tau_law"]).all(axis=1)
    assert finding.fault == "LAW"
    assert int(np.argmax(struck)) == finding.tick >= begins
    assert np.isfinite(ran.rows["tau"]).all(), "no drive gets the invalid force"
    assert not ran.ending.success
    if raises:
        assert "ZeroDivisionError: a {defect}" in finding.text
        assert __file__ in finding.text
    else:
        assert (finding.leg, str(finding.value)) == (3, "nan")
        json.dumps(story.fields(), allow_nan=False)
