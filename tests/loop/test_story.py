"""Faults of a whole simulated run: the story's leg, value and limit are the plant's own, and the log has it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.signals import Command, DriveMode, Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.loop.motion import Motion
from hil.loop.run_end import Course
from hil.loop.story.told import Story
from hil.record.log import Log
from plant_fmu.faults.kinds import (
    BrakeStuckOpen,
    DriveSign,
    DriveSilence,
    EncoderJump,
    EncoderLost,
    FramesLoss,
    PlantCrash,
    PlantNaN,
)
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad
from tests.drivers.legs_frames import command_frames
from tests.loop.test_attacks import Attacked
from tests.loop.test_held import Ran, begins, configuration, run

SWAPPED_s = 1.6


@pytest.fixture(scope="module")
def good() -> Ran:
    return run(load("virtual"))


def story_of(ran: Ran) -> Story:
    assert ran.ending.story is not None
    return ran.ending.story


def test_a_leg_whose_wires_are_swapped_is_named_with_its_distance_from_the_reference():
    ran = run(load("virtual"), DriveSign(leg=3, at_s=SWAPPED_s))
    story = story_of(ran)
    finding, cause = story.findings
    assert (cause.fault, cause.seen.leg) == ("DRIVE", 3)
    row, true = ran.rows[finding.tick], ran.true[finding.tick]
    error = np.abs(row["q_d"] - true)
    assert (finding.fault, finding.seen.leg) == ("FOLLOWING", int(error.argmax())) == ("FOLLOWING", 3)
    assert finding.seen.value == pytest.approx(error[3], abs=2e-4)
    assert finding.seen.limit == pytest.approx(0.01 + 0.01 * abs(row["dq_d"][3]))
    assert finding.seen.value > finding.seen.limit  # type: ignore[operator]
    assert ran.rows[finding.tick - 1]["faults"] == 0
    assert row["faults"] == Fault.FOLLOWING
    assert finding.time_s == pytest.approx(1e-3 * finding.tick)
    assert f"leg 3 is {1e3 * finding.seen.value:.2f} mm" in ran.ending.trouble  # type: ignore[operator]
    assert "the drives were told to switch off: all six in OFF" in ran.ending.trouble


@pytest.mark.parametrize("leg", broad((4, 1, 0, 2, 3, 5), quick=1))
def test_a_silent_drive_is_named_with_the_ticks_since_it_was_heard(leg):
    ran = run(load("virtual"), DriveSilence(leg=leg, at_s=1.4))
    (finding,) = story_of(ran).findings
    assert (finding.fault, *finding.seen[:3]) == ("STALE", 5, 5, leg)
    assert finding.tick == 1400 + 4
    assert ran.ending.trouble.endswith(f"not all are proven shut; not confirmed by drive {leg}")


def test_a_lost_encoder_is_a_stale_leg_whose_drive_still_speaks():
    ran = run(load("virtual"), EncoderLost(leg=1, at_s=1.4))
    (finding,) = story_of(ran).findings
    assert (finding.fault, finding.seen.leg) == ("STALE", 1)
    assert "not confirmed" not in ran.ending.trouble, "it says that it brakes"


def test_lost_frames_name_no_leg_and_no_drive_is_said_to_have_obeyed():
    ran = run(load("virtual"), FramesLoss(at_s=1.4))
    story = story_of(ran)
    (finding,) = story.findings
    assert (finding.fault, finding.seen.leg) == ("STALE", None)
    assert "not confirmed by drive 0, 1, 2, 3, 4, 5" in story.done_text
    assert "all six" not in story.done_text


def test_a_brake_that_stays_open_when_parking_is_told_with_the_way_of_its_leg(good):
    ran = run(load("virtual"), BrakeStuckOpen(leg=4, at_s=begins(good, Mode.TRACKING, 0.5)))
    story = story_of(ran)
    (finding,) = story.findings
    assert (finding.fault, finding.seen.leg, finding.mode) == ("BRAKE", 4, "UNLOADING")
    moved = np.abs(ran.true[finding.tick] - ran.true[ran.first(Mode.UNLOADING)])
    assert int(moved.argmax()) == 4
    assert finding.seen.value == pytest.approx(moved[4], abs=5e-5)
    assert finding.seen.limit == 5e-4
    assert [step.mode for step in story.done] == ["HELD"]
    assert "switch off" not in "".join(story.lines())


def test_an_encoder_that_jumps_far_is_told_before_what_its_length_spoils():
    ran = run(load("ideal"), EncoderJump(leg=5, by_m=1.0, at_s=0.5), duration_s=1.0)
    story = story_of(ran)
    assert [each.fault for each in story.findings] == ["ENCODER", "KINEMATICS", "ASSEMBLY", "FOLLOWING"]
    first, last = story.findings[0], story.findings[-1]
    assert first.seen.leg == 5
    assert first.seen.value == pytest.approx(1.0, abs=1e-4)
    assert last.seen.leg == 5
    assert last.seen.value == pytest.approx(
        abs(ran.true[last.tick][5] + 1.0 - ran.rows[last.tick]["q_d"][5]), abs=1e-3
    )
    assert last.seen.limit == pytest.approx(0.5, rel=0.1)


def test_a_brake_that_slips_names_a_limit_of_this_configuration():
    c = configuration(
        "virtual",
        ("internal_step_us: 100", "internal_step_us: 100\n    brake_force_N: 3200"),
        ("standstill_m: 5e-4", "standstill_m: 7e-4"),
    )
    story = story_of(run(c))
    assert {each.seen.limit for each in story.findings} == {7e-4}
    assert all(each.seen.value > 7e-4 for each in story.findings)  # type: ignore[operator]
    assert "limits.standstill_m is 0.7 mm" in story.short


def test_drives_that_a_forged_command_switched_off_are_named():
    """Our controller does not hear it, behind a gateway; before: `DRIVE`, without a leg."""
    c = load("virtual")
    nodes, plant = build_nodes(c)
    bench = Attacked(build_cycle(c, 1000.0, 0.01), nodes, (BitTiming.of(c.bus),), c.loop.window_s(1000.0))
    course = Course(bench.cycle)
    while bench.cycle.mode is not Mode.APPROACH:
        bench.step(course.commands(bench.tick + 1))
        assert course.ending(bench.tick) is None
    bench.audible = False
    protocol, off = bench.cycle.parts.protocol, Command(DriveMode.OFF, np.zeros(6))
    bench.attack = lambda tick: command_frames(protocol, off, tick)
    ending = None
    while ending is None:
        bench.step(course.commands(bench.tick + 1))
        ending = course.ending(bench.tick)
    plant.close()
    assert ending.story is not None
    assert [(each.fault, each.seen.leg, each.seen.value) for each in ending.story.findings] == [
        ("DRIVE", leg, "OFF") for leg in range(6)
    ]
    said = "drive 0, 1, 2, 3, 4, 5 in OFF where RUN was asked for: not on our command"
    assert ending.reason == f"latched fault DRIVE ({said})"


@pytest.mark.long
def test_the_log_the_summary_and_the_replay_tell_the_same(tmp_path):
    """With leg and value in fields that a program reads, in the tick of the fault and at the end."""
    path = tmp_path / "fault.mcap"
    summary = simulate(load("virtual"), log=path, faults=FaultPlan([DriveSign(leg=3, at_s=SWAPPED_s)]))
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


def test_a_good_run_has_no_story(tmp_path):
    summary = simulate(load("virtual"), log=tmp_path / "good.mcap", duration_s=0.8)
    assert summary["story"] is None
    assert summary["trouble"] is None
    assert Log.open(tmp_path / "good.mcap").events() == []


PLANT_FAILS = [
    (PlantCrash(at_s=1.6), "the plant crashed: fault plant_crash"),
    (PlantNaN(at_s=1.6), "the plant gave what is no measurement: feedback of leg 0 is not a number: nan m"),
]


@pytest.mark.parametrize(("fault", "words"), PLANT_FAILS)
def test_a_plant_that_fails_ends_the_simulation_with_what_it_said_and_what_the_drives_did(
    fault, words, tmp_path
):
    path = tmp_path / "plant.mcap"
    summary = simulate(load("virtual"), log=path, faults=FaultPlan([fault]))
    story = summary["story"]
    assert not summary["success"]
    assert summary["trouble"].startswith(words)
    assert story["plant"].startswith(words)
    assert story["findings"] == []
    assert {each["state"] for each in story["drives_at_end"]} == {"RUN"}
    (step,) = story["done"]
    assert (step["tick"], step["mode"], step["text"]) == (1599, "PLANT", "the simulation ended with it")
    assert story["lines"][-1] == "next: mend the plant: its own words stand above (docs/guides/own-fmu.md)"
    assert Log.open(path).metadata["summary"]["reason"] == summary["trouble"]


@pytest.mark.parametrize(("fault", "words"), broad(PLANT_FAILS, quick=1))
def test_a_plant_that_fails_after_a_fault_does_not_hide_it(fault, words, tmp_path):
    path = tmp_path / "both.mcap"
    faults = FaultPlan([DriveSilence(leg=2, at_s=1.55), fault])
    summary = simulate(load("virtual"), log=path, faults=faults)
    trouble, story = summary["trouble"], summary["story"]
    assert trouble.startswith(words)
    assert "; before that: latched fault STALE (leg 2 not heard for 5 ticks, " in trouble
    assert " at tick 1554: the brakes were told to close " in trouble
    assert trouble.endswith("; the simulation ended with it")
    assert [(each["fault"], each["leg"], each["tick"]) for each in story["findings"]] == [("STALE", 2, 1554)]
    assert [step["mode"] for step in story["done"]] == ["HELD", "PLANT"]
    assert story["drives"][2]["age"] == 5
    assert story["drives_at_end"][2]["age"] > 45
    assert any(line.startswith("plant: ") for line in story["lines"])
    assert Log.open(path).metadata["summary"]["story"] == json.dumps(story)


# -- each fault of the motion really happens ---------------------------------------------------------------------

UP_AND_DOWN = """reference:
  type: sinusoids
  duration_s: 10
  components: [{axis: z_m, amplitude: 0.5, frequency_Hz: 0.5}]

"""
"""From 1 m: sqrt(1.24^2 + z^2) is 1.8 m at z = 1.305 m, 1.4 m at z = 0.65 m."""


def on_another_path(*changes: tuple[str, str]) -> Configuration:
    text = load("virtual").text
    first, last = text.index("\nreference:") + 1, text.index("\nlimits:") + 1
    text = text[:first] + UP_AND_DOWN + text[last:]
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "my.yaml")


def swinging() -> Configuration:
    """Legs on springs that are stopped within 20 ms and hardly damped, each at a frequency of its own."""
    return configuration(
        "bench",
        ("kp_N_m: 2e5 ", "kp_N_m: [1e5, 1.5e5, 2e5, 2.5e5, 3e5, 3.5e5] "),
        ("kv_N_s_m: 12650 ", "kv_N_s_m: [350, 500, 650, 800, 950, 1100] "),
        ("stop_s: 0.5", "stop_s: 0.02"),
        ("speed_m_s: 0.6 ", "speed_m_s: 3 "),
        ("following_error_m: 0.02", "following_error_m: 0.2"),
    )


class Real(NamedTuple):
    """What makes a fault happen, and what the log's columns say of each leg that is named."""

    fault: Fault
    configuration: Callable[[], Configuration]
    duration_s: float
    value: Callable[[Any], Any]
    """Of the row: (6,) per leg, or one number; the rules' own definition."""
    limit: Callable[[Any], Any]


REAL = {
    "SPEED": Real(
        Fault.SPEED,
        lambda: configuration("virtual", ("speed_m_s: 2 ", "speed_m_s: 0.5 ")),
        2.0,
        lambda row: np.abs(row["dq"]),
        lambda row: np.full(6, 0.5),
    ),
    "STROKE, before the upper soft end": Real(
        Fault.STROKE,
        lambda: on_another_path(("length_max_m: 2.2", "length_max_m: 1.8")),
        2.0,
        lambda row: row["dq"],
        lambda row: np.sqrt(2 * 10 * (1.78 - row["q"])),
    ),
    "STROKE, before the lower soft end": Real(
        Fault.STROKE,
        lambda: on_another_path(("length_min_m: 0.75", "length_min_m: 1.4")),
        3.0,
        lambda row: -row["dq"],
        lambda row: np.sqrt(2 * 10 * (row["q"] - 1.42)),
    ),
    "STROKE, a hard end": Real(
        Fault.STROKE,
        lambda: on_another_path(
            ("length_max_m: 2.2", "length_max_m: 1.8"),
            ("stroke_margin_m: 0.02", "stroke_margin_m: 0"),
            ("deceleration_m_s2: 10 ", "deceleration_m_s2: 1e6 "),
        ),
        2.0,
        lambda row: row["q"],
        lambda row: np.full(6, 1.8),
    ),
    "FOLLOWING, behind the reference": Real(
        Fault.FOLLOWING,
        lambda: configuration("virtual", ("  force_N: 25000 ", "  force_N: 5000 ")),
        2.0,
        lambda row: np.abs(row["q_d"] - row["q"]),
        lambda row: 0.01 + 0.01 * np.abs(row["dq_d"]),
    ),
    "FOLLOWING, not at rest": Real(
        Fault.FOLLOWING, swinging, 3.25, lambda row: np.abs(row["dq"]), lambda row: np.full(6, 0.02)
    ),
    "CONDITION": Real(
        Fault.CONDITION,
        lambda: configuration("virtual", ("condition: 50 ", "condition: 4 ")),
        2.5,
        lambda row: row["condition"],
        lambda row: 4.0,
    ),
}


@pytest.mark.parametrize("real", broad(map(pytest.param, REAL.values()), quick=5), ids=REAL)
def test_a_fault_of_the_motion_is_told_with_the_legs_values_and_limits_of_the_log(real):
    ran = run(real.configuration(), duration_s=real.duration_s)
    found = [each for each in story_of(ran).findings if each.fault == real.fault.name]
    row, before = (ran.rows[found[0].tick - n] for n in (0, 1))
    assert row["faults"] == real.fault
    assert before["faults"] == 0
    values, limits = (np.atleast_1d(each(row)) for each in (real.value, real.limit))
    named = [each.seen.leg or 0 for each in found if each.tick == found[0].tick]
    assert named == np.flatnonzero(values > limits).tolist()
    for each in found[: len(named)]:
        leg = each.seen.leg or 0
        assert each.seen.value == pytest.approx(values[leg], rel=1e-12)
        assert each.seen.limit == pytest.approx(limits[leg], rel=1e-9)
    if real.fault is not Fault.CONDITION:
        true = ran.true[found[0].tick]
        assert row["q"] == pytest.approx(true, abs=2e-3), "what was measured is where the legs are"


def test_a_law_that_gives_no_number_for_a_leg_is_told_with_it(monkeypatch):
    """A defect of somebody's own law: no shipped one has it."""
    effort = JointInverseDynamics.effort

    def defective(self, tick):
        effort(self, tick)
        if tick["tick"] >= 1400:
            tick["tau_law"][3] = np.nan

    monkeypatch.setattr(JointInverseDynamics, "effort", defective)
    ran = run(load("virtual"))
    (finding,) = story_of(ran).findings
    assert (finding.fault, finding.tick, finding.seen.leg) == ("LAW", 1400, 3)
    assert str(finding.seen.value) == "nan"
    assert np.flatnonzero(~np.isfinite(ran.rows[1400]["tau_law"])).tolist() == [3]
    assert finding.text == "the law asks leg 3 for nan N, not for a finite force"
    json.dumps(story_of(ran).fields(), allow_nan=False)
    assert np.isfinite(ran.rows["tau"]).all(), "no drive is ever sent it"
    assert not ran.ending.success


@pytest.mark.parametrize(("begins", "speed"), [(0, -1.0), (1400, -1.0), (1400, 0.1)])
def test_a_law_that_raises_is_a_latched_fault_with_what_it_raised_and_where(monkeypatch, begins, speed):
    """From the start, from a tick on, and in motion alone: not where it is asked what holds the platform."""
    effort = JointInverseDynamics.effort

    def defective(self, tick):
        effort(self, tick)
        if tick["tick"] >= begins and abs(tick["dq"]).max() > speed:
            raise ZeroDivisionError("a {defect}")

    monkeypatch.setattr(JointInverseDynamics, "effort", defective)
    ran = run(load("virtual"))
    (finding,) = story_of(ran).findings
    assert finding.fault == "LAW"
    assert re.fullmatch(
        rf"the law raised ZeroDivisionError: a {{defect}} \({re.escape(__file__)}, line \d+\)", finding.text
    )
    struck = np.isnan(ran.rows["tau_law"]).any(axis=1)
    assert int(np.argmax(struck)) == finding.tick >= begins
    assert np.isfinite(ran.rows["tau"]).all(), "no drive is ever sent it"
    assert not ran.ending.success


def test_a_reference_that_is_no_number_is_told_with_the_columns_it_spoils(monkeypatch):
    """No measurement leads there, as drives and sensors that send no numbers are refused."""
    start = Motion.start

    class Defective:
        def __init__(self, sound, tick):
            self.sound, self.tick, self.duration_s = sound, tick, sound.duration_s

        def sample(self, t):
            whole = self.sound.sample(t)
            return whole._replace(twist=whole.twist * (np.nan if self.tick + round(1e3 * t) >= 1400 else 1.0))

    def defective(self, trajectory, tick, then=None):
        start(self, trajectory, tick, then)
        self._go_along(Defective(trajectory, tick))

    monkeypatch.setattr(Motion, "start", defective)
    ran = run(load("virtual"))
    found = [each for each in story_of(ran).findings if each.fault == "NOT_FINITE"]
    row = ran.rows[1400]
    assert [each.seen.leg for each in found] == [*range(6), None]
    for each in found:
        assert each.tick == 1400
        column = each.text.split(" ")[0]
        assert not np.isfinite(row[column][each.seen.leg or 0])
    assert found[-1].text == "twist_d is nan, not a finite number"
    assert np.isfinite(ran.rows["tau"]).all()
    assert not ran.ending.success
