"""The procedure: one brake at a time, small force, short travel; it can be interrupted and resumed."""

import json
from pathlib import Path

import pytest

import hil
from drivers.signals import DriveMode, DriveState
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.lab.bringup.context import Finding, RefusedError
from hil.lab.bringup.procedure import STEPS, merged
from hil.lab.bringup.steps import scan
from tests.broad import broad
from tests.hil.lab.bringup.families import FAMILIES, family
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

ALONE = STEPS[:5]


@pytest.fixture(scope="module")
def good():
    """A machine without mistakes after all steps."""
    rehearsal = Rehearsal("virtual")
    return rehearsal, rehearsal.run()


def test_bring_up_of_a_good_machine_opens_one_brake_at_a_time_with_small_force_and_travel(good):
    rehearsal, outcome = good
    assert outcome.findings == ()
    assert outcome.passed == tuple(step.name for step in STEPS)
    assert rehearsal.watched.most_open == 1
    assert 0.0 < rehearsal.watched.most_force_N <= 0.02 * 30_000 * 1.001
    assert 1e-4 < rehearsal.watched.most_travel_m < 1e-3


def test_measured_watchdog_friction_scale_and_sign_agree_with_the_virtual_machine(good):
    rehearsal, _ = good
    for leg in range(6):
        watchdog = rehearsal.context.known("watchdog", leg)
        assert watchdog["since_s"] <= 0.010 <= watchdog["until_s"] <= 0.014
        assert rehearsal.context.known("opens", leg)["hand_N"] == pytest.approx(30.0, rel=0.02)
        assert rehearsal.context.known("encoder", leg)["scale"] == pytest.approx(1.0, abs=1e-3)
        fact = rehearsal.context.known("force", leg)
        assert (fact["plus"]["way"], fact["minus"]["way"], fact["plus"]["leg"]) == (1, -1, leg)


def test_bring_up_ends_with_all_drives_off_and_their_watchdog_times_restored(good):
    rehearsal, _ = good
    nodes = rehearsal.bench.nodes
    assert [DriveState(int(s)) for s in nodes.snapshot().state] == [DriveState.OFF] * 6
    assert nodes._drives.seen.watchdog_ns.tolist() == [10_000_000] * 6


@pytest.mark.long
def test_bring_up_with_one_bus_per_leg_opens_one_brake_at_a_time(tmp_path):
    text = (Path(hil.__file__).parents[1] / "configs" / "two_buses.yaml").read_text()
    first = text.index("  channels:")
    last = text.index("\n\n", first)
    channels = "".join(f"\n    - {{channel: bus{leg}, legs: [{leg}]}}" for leg in range(6))
    (tmp_path / "six.yaml").write_text(text[:first] + "  channels:" + channels + text[last:])
    rehearsal = Rehearsal(str(tmp_path / "six.yaml"))
    outcome = rehearsal.run(STEPS[:6])
    assert outcome.findings == ()
    assert rehearsal.watched.most_open == 1


def test_bring_up_step_without_measurements_has_not_passed():
    rehearsal = Rehearsal("virtual", "brake_stuck_open leg=5")
    outcome = rehearsal.run()
    assert ("brake_stuck_open", (5,)) in named(outcome)
    assert not {"force", "gauge"} & set(outcome.passed)


@pytest.mark.parametrize("mistake", ["watchdog_missing", "watchdog_long", "watchdog_short"])
def test_wrong_watchdog_is_found_before_any_brake_opens(mistake):
    rehearsal = Rehearsal("virtual", f"{mistake} leg=4")
    assert named(rehearsal.run()) == {(mistake, (4,))}
    assert rehearsal.watched.most_open == 0


def test_no_brake_opens_if_another_drive_cannot_be_locked_out():
    rehearsal = Rehearsal("virtual", "watchdog_missing leg=4")
    rehearsal.run((scan.STEP,))
    why = rehearsal.drives.power(0)
    assert "legs [4] did not go to FAULT" in why
    assert rehearsal.watched.most_open == 0
    assert DriveState(int(rehearsal.drives.record["drive_state"][0])) == DriveState.OFF


def test_ctrl_c_with_an_open_brake_removes_force_and_power():
    rehearsal = Rehearsal("virtual", stop_at=61)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(ALONE)
    stopped_at = rehearsal.hands.requests[-1]
    assert stopped_at.act in ("push", "read_push", "let_go")
    assert "open" in rehearsal.hands.requests[59].text + rehearsal.hands.requests[60].text
    snapshot = rehearsal.bench.nodes.snapshot()
    assert not snapshot.force.any()
    assert snapshot.brake.tolist() == [1.0] * 6
    assert not {DriveState.READY, DriveState.RUN} & {DriveState(int(s)) for s in snapshot.state}

    resumed = Rehearsal("virtual", facts=rehearsal.context.facts)
    assert resumed.run(ALONE).success
    asked = [(r.act, r.leg) for r in resumed.hands.requests]
    assert ("measure", 0) not in asked
    assert len(asked) == 6 * 7
    assert resumed.context.known("opens", 5)["legs"] == [5]


def test_brake_is_reported_as_holding_only_after_the_operator_pushed_the_leg():
    """The brake of leg 3 does not shut; the operator pushes only after the gauge's 0 N was refused."""
    rehearsal = Rehearsal("virtual", "brake_stuck_open leg=3")
    ask, reads = rehearsal.hands.ask, []

    def lazy(request):
        if request.act == "push" and "shut" in request.text and request.leg == 3:
            request = request._replace(act="let_go")
        if request.act == "read_held" and request.leg == 3:
            reads.append(request.within)
            if len(reads) == 2:
                rehearsal.bench.do("push", 3)
        ask(request)

    rehearsal.hands.ask = lazy  # type: ignore[method-assign]
    waits = iter(range(200))
    answer = rehearsal.hands.answer
    rehearsal.hands.answer = lambda: None if len(reads) == 2 and next(waits, None) is not None else answer()  # type: ignore[method-assign]
    assert named(rehearsal.run(ALONE)) == {("brake_stuck_open", (3,))}
    # 2 % of the rated 30 kN
    assert reads == [(600.0, 30_000.0)] * 2


def test_without_consent_no_drive_is_polled_or_powered():
    rehearsal = Rehearsal("virtual")
    rehearsal.hands.agrees = False
    with pytest.raises(RefusedError, match="before step scan"):
        rehearsal.run()
    assert rehearsal.hands.requests == []
    assert rehearsal.watched.most_open == 0
    assert "scan" not in rehearsal.context.facts


def test_bring_up_ends_after_a_finding_of_a_step_that_later_steps_depend_on():
    rehearsal = Rehearsal("virtual", "encoder_frozen leg=1")
    outcome = rehearsal.run()
    assert (outcome.stopped, outcome.passed) == ("ids", ("scan", "watchdog"))
    assert not {r.act for r in rehearsal.hands.requests} - {"move"}


def test_wrong_encoder_sign_and_wrong_force_sign_of_a_leg_are_one_finding_reversed_drive():
    sign = [Finding(name, (2,), "", "") for name in ("encoder_sign", "force_sign")]
    other = Finding("force_sign", (4,), "", "")
    assert [(f.name, f.legs) for f in merged(Rehearsal("virtual").context, [*sign, other])] == [
        ("force_sign", (4,)),
        ("drive_reversed", (2,)),
    ]


POLLED = ["moteus_stopped", *[name for name in FAMILIES if "legs" not in name and name != "moteus_stopped"]]


@pytest.mark.parametrize("name", broad(POLLED, quick=1))
def test_brakes_without_opening_delay_open_one_at_a_time(name):
    """A drive enabled for one tick opens no brake that takes 40 ms, so only a brake without delay shows it."""
    c, at_once = family(name), {"plant": {"drives": {"brake_open_ms": 0, "brake_close_ms": 0}}}
    rehearsal = Rehearsal(loads(with_changes(c.text, at_once), name, c.folder))
    assert rehearsal.run(STEPS[:2]).findings == ()
    assert rehearsal.watched.most_open <= 1


def test_unproven_bring_up_step_needs_acceptance_by_the_operator_and_has_not_passed():
    rehearsal = Rehearsal("cubemars")
    outcome = rehearsal.run(STEPS[:2])
    assert outcome.passed == ("scan",)
    ((step, gap),) = outcome.gaps
    assert step == "watchdog"
    assert gap.remedy
    assert [(r.act, r.word) for r in rehearsal.hands.requests] == [("accept", "accept")]
    assert rehearsal.watched.most_open == 0


@pytest.mark.parametrize("family", ["cia402_difference", "odrive"])
def test_drives_with_separate_command_frames_are_powered_one_at_a_time(family):
    """The five others are commanded off; these drives cannot be locked out and need not be."""
    rehearsal = Rehearsal(family)
    assert not rehearsal.drives.locks
    rehearsal.run(STEPS[:1])
    assert rehearsal.drives.power(3) == ""
    for _ in range(20):
        rehearsal.drives.step(DriveMode.RUN, 3)
    states = [DriveState(int(s)) for s in rehearsal.bench.nodes.snapshot().state]
    assert states[3] is DriveState.RUN
    assert not {DriveState.READY, DriveState.RUN} & {*states[:3], *states[4:]}


def test_bring_up_waits_for_a_slow_heartbeat_to_report_the_brake():
    c = family("odrive")
    slow = with_changes(c.text, {"drives": {"heartbeat_ms": 250}})
    rehearsal = Rehearsal(loads(slow, "odrive", c.folder))
    assert not any(rehearsal.drives.prepare(None))
    for leg in (4, 1):
        with rehearsal.context.opened(leg):
            for _ in range(3):
                rehearsal.context.drive(leg)
            assert rehearsal.bench.nodes.snapshot().brake.tolist() == [float(k != leg) for k in range(6)]
    assert rehearsal.bench.nodes.snapshot().brake.all()
    assert rehearsal.watched.most_open == 1


SLOW = {
    "engage": {"brake_release_s": 0.03, "brake_close_s": 0.16},
    "plant": {"drives": {"brake_open_ms": 25, "brake_close_ms": 150}},
}
"""Brakes that close more slowly than they open, and take longer than powering a drive."""


@pytest.mark.parametrize("name", ["virtual", "desktop"])
def test_slow_brake_is_shut_before_the_next_one_opens(name):
    """With one command frame for all drives and with one for each: every leg, and the first leg again."""
    rehearsal = Rehearsal(loads(with_changes(load(name).text, SLOW), name))
    rehearsal.drives.prepare(None)
    for leg in (0, 1, 2, 3, 4, 5, 0):
        with rehearsal.context.opened(leg):
            assert rehearsal.bench.nodes.snapshot().brake[leg] == 0.0
        assert rehearsal.bench.nodes.snapshot().brake.tolist() == [1.0] * 6
    assert rehearsal.watched.most_open == 1


def test_two_brakes_on_one_output_are_found_and_get_no_force():
    rehearsal = Rehearsal("virtual", "brake_of_another leg=1 other=4")
    outcome = rehearsal.run(STEPS[:6])
    assert named(outcome) == {("brake_crossed", (1, 4))}
    assert rehearsal.context.known("opens", 4)["legs"] == [4]
    assert rehearsal.watched.most_open == 2
    assert rehearsal.context.known("force", 1) is None
    assert rehearsal.context.known("force", 4) is not None


@pytest.mark.long
def test_bring_up_killed_after_any_measurement_resumes_there_and_succeeds():
    """SIGKILL leaves the last saved state: the facts at several moments are read back from JSON."""
    rehearsal = Rehearsal("virtual")
    moments: list[str] = []
    rehearsal.context.save = lambda: moments.append(json.dumps(rehearsal.context.facts))
    assert rehearsal.run().success
    asked = len(rehearsal.hands.requests)
    for moment in moments[1::6]:
        facts = json.loads(moment)
        resumed = Rehearsal("virtual", facts=facts)
        resumed.bench.hung = "platform" in facts
        outcome = resumed.run()
        assert outcome.success, outcome.findings
        assert resumed.watched.most_open <= 1
        assert resumed.watched.opened_while_hung == 0
        assert len(resumed.hands.requests) <= asked
