"""The procedure itself: one brake, little force, a short way; ended at any moment; resumed."""

from pathlib import Path

import numpy as np
import pytest

import hil
from drivers.signals import DriveState
from hil.lab.bringup.context import Finding, RefusedError
from hil.lab.bringup.procedure import STEPS, merged
from hil.lab.bringup.steps import encoder, force, ids, scan, silence
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named

ALONE = STEPS[:5]


@pytest.fixture(scope="module")
def good():
    """A machine without mistakes after all steps."""
    rehearsal = Rehearsal("virtual", Wiring())
    return rehearsal, rehearsal.run()


def test_a_good_machine_passes_every_step(good):
    _, outcome = good
    assert outcome.findings == ()
    assert outcome.passed == tuple(step.name for step in STEPS)


def test_no_two_brakes_are_open_and_force_and_way_stay_small(good):
    rehearsal, _ = good
    assert rehearsal.watched.most_open == 1
    assert 0.0 < rehearsal.watched.most_force_N <= 0.02 * 30_000 * 1.001
    assert 1e-4 < rehearsal.watched.most_travel_m < 1e-3


@pytest.mark.long
def test_no_two_brakes_are_open_where_each_leg_has_a_bus_of_its_own(tmp_path):
    text = (Path(hil.__file__).parents[1] / "configs" / "two_buses.yaml").read_text()
    first = text.index("  channels:")
    last = text.index("\n\n", first)
    channels = "".join(f"\n    - {{channel: bus{leg}, legs: [{leg}]}}" for leg in range(6))
    (tmp_path / "six.yaml").write_text(text[:first] + "  channels:" + channels + text[last:])
    rehearsal = Rehearsal(str(tmp_path / "six.yaml"), Wiring())
    outcome = rehearsal.run(STEPS[:6])
    assert outcome.findings == ()
    assert rehearsal.watched.most_open == 1


def test_a_leg_that_slips_off_the_gauge_while_it_is_read_is_switched_off():
    rehearsal = Rehearsal("lab", Wiring())
    hands, bench = rehearsal.hands, rehearsal.bench
    ask, answer, late = hands.ask, hands.answer, []

    def slips(request):
        ask(request)
        if (
            request.act == "read_gauge"
            and rehearsal.drives.record["tau"][2] > 0.9 * rehearsal.machine.force_N
        ):
            bench.do("free")
            late.append(bench.length(2))

    hands.ask = slips  # type: ignore[method-assign]
    waits = iter(range(2000))
    hands.answer = lambda: None if late and next(waits, None) is not None else answer()  # type: ignore[method-assign]
    outcome = rehearsal.run()
    assert ("runaway", (2,)) in named(outcome)
    assert abs(bench.length(2) - late[0]) < 0.02


def test_a_drive_that_falls_silent_with_its_brake_open_is_named():
    rehearsal = Rehearsal("virtual", Wiring())
    step = rehearsal.drives.line.exchange

    def deaf(opening):
        heard = step(opening)
        if np.abs(rehearsal.drives.record["tau"][2]) > 0.0:
            lost = rehearsal.c.drives.node_ids[2]
            kept = tuple(each for each in heard.frames if each.frame.id & 0x7F != lost)
            heard = heard._replace(frames=kept)
        return heard

    rehearsal.drives.line.exchange = deaf  # type: ignore[method-assign]
    outcome = rehearsal.run()
    assert ("lost_power", (2,)) in named(outcome)


def test_what_was_not_measured_has_not_passed():
    rehearsal = Rehearsal("virtual", wired(Mistake("brake_stuck_open", 5)))
    outcome = rehearsal.run()
    assert ("brake_stuck_open", (5,)) in named(outcome)
    assert not {"force", "gauge"} & set(outcome.passed)


def test_the_watchdog_is_measured_beside_the_configured_one(good):
    rehearsal, _ = good
    for leg in range(6):
        fact = rehearsal.context.known("watchdog", leg)
        assert fact["since_s"] <= 0.010 <= fact["until_s"] <= 0.014


def test_friction_scale_and_sign_are_those_of_the_bench(good):
    rehearsal, _ = good
    for leg in range(6):
        assert rehearsal.context.known("opens", leg)["hand_N"] == pytest.approx(30.0, rel=0.02)
        assert rehearsal.context.known("encoder", leg)["scale"] == pytest.approx(1.0, abs=1e-3)
        fact = rehearsal.context.known("force", leg)
        assert (fact["plus"]["way"], fact["minus"]["way"], fact["plus"]["leg"]) == (1, -1, leg)


def test_at_the_end_all_drives_are_off_with_their_own_watchdogs(good):
    rehearsal, _ = good
    nodes = rehearsal.bench.nodes
    assert [DriveState(int(s)) for s in nodes.snapshot().state] == [DriveState.OFF] * 6
    assert nodes._drives.seen.watchdog_ns.tolist() == [10_000_000] * 6


def test_three_rotated_drives_are_named_with_the_order_that_mends_it():
    rehearsal = Rehearsal("virtual", wired(Mistake("ids_rotated", 1, 4, 2)))
    outcome = rehearsal.run(ALONE)
    assert named(outcome) == {("ids", (1, 2, 4))}
    assert "drives.node_ids: [1, 3, 5, 4, 2, 6]" in outcome.findings[0].mend


def test_one_percent_of_scale_is_named():
    rehearsal = Rehearsal("virtual", wired(Mistake("encoder_scale", 2, value=1.01)))
    assert named(rehearsal.run((scan.STEP, silence.STEP, ids.STEP, encoder.STEP))) == {
        ("encoder_scale", (2,))
    }


@pytest.mark.parametrize(
    ("mistake", "name"),
    [
        ("watchdog_missing", "watchdog_missing"),
        ("watchdog_long", "watchdog_long"),
        ("watchdog_short", "watchdog_short"),
    ],
)
def test_a_drive_without_its_watchdog_is_named_before_any_brake_opens(mistake, name):
    rehearsal = Rehearsal("virtual", wired(Mistake(mistake, 4)))
    assert named(rehearsal.run()) == {(name, (4,))}
    assert rehearsal.watched.most_open == 0


def test_no_brake_opens_beside_a_drive_that_cannot_be_locked_out():
    rehearsal = Rehearsal("virtual", wired(Mistake("watchdog_missing", 4)))
    rehearsal.run((scan.STEP,))
    why = rehearsal.drives.power(0)
    assert "legs [4] did not latch" in why
    assert rehearsal.watched.most_open == 0
    assert DriveState(int(rehearsal.drives.record["drive_state"][0])) == DriveState.OFF


def test_a_leg_that_runs_away_is_stopped_and_named():
    rehearsal = Rehearsal("virtual", wired(Mistake("force_scale", 3, value=60.0)))
    outcome = rehearsal.run((*ALONE, force.STEP))
    assert named(outcome) == {("runaway", (3,))}
    assert rehearsal.watched.most_open == 1


def test_ctrl_c_with_a_brake_open_takes_force_and_power_away_and_keeps_what_is_known():
    rehearsal = Rehearsal("virtual", Wiring(), stop_at=61)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(ALONE)
    stopped_at = rehearsal.hands.requests[-1]
    assert stopped_at.act in ("push", "read_push", "let_go")
    assert "open" in rehearsal.hands.requests[59].text + rehearsal.hands.requests[60].text
    snapshot = rehearsal.bench.nodes.snapshot()
    assert not snapshot.force.any()
    assert snapshot.brake.tolist() == [1.0] * 6
    assert not {DriveState.READY, DriveState.RUN} & {DriveState(int(s)) for s in snapshot.state}

    resumed = Rehearsal("virtual", Wiring(), facts=rehearsal.context.facts)
    assert resumed.run(ALONE).success
    asked = [(r.act, r.leg) for r in resumed.hands.requests]
    assert ("measure", 0) not in asked
    assert len(asked) == 6 * 5
    assert resumed.context.known("opens", 5)["legs"] == [5]


def test_a_brake_that_nobody_has_pushed_on_has_not_held():
    """The brake of leg 3 does not shut; the operator pushes only once the gauge's 0 N has been refused."""
    rehearsal = Rehearsal("virtual", wired(Mistake("brake_stuck_open", 3)))
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


def test_without_consent_nothing_is_polled_or_powered():
    rehearsal = Rehearsal("virtual", Wiring())
    rehearsal.hands.agrees = False
    with pytest.raises(RefusedError, match="before step scan"):
        rehearsal.run()
    assert rehearsal.hands.requests == []
    assert rehearsal.watched.most_open == 0
    assert "scan" not in rehearsal.context.facts


def test_nothing_after_a_mistake_that_a_gate_has_named():
    rehearsal = Rehearsal("virtual", wired(Mistake("encoder_frozen", 1)))
    outcome = rehearsal.run()
    assert (outcome.stopped, outcome.passed) == ("ids", ("scan", "watchdog"))
    assert not {r.act for r in rehearsal.hands.requests} - {"move"}


def test_polled_motors_are_opened_one_at_a_time_without_a_lock_out():
    rehearsal = Rehearsal("desktop", wired(Mistake("watchdog_missing", 2)))
    assert not rehearsal.drives.locks
    assert named(rehearsal.run(STEPS[:2])) == {("watchdog_missing", (2,))}
    assert rehearsal.watched.most_open == 1


def test_one_cause_has_one_name():
    sign = [Finding(name, (2,), "", "") for name in ("encoder_sign", "force_sign")]
    other = Finding("force_sign", (4,), "", "")
    assert [(f.name, f.legs) for f in merged([*sign, other])] == [
        ("force_sign", (4,)),
        ("drive_reversed", (2,)),
    ]


def test_the_steps_say_what_they_do_and_how_they_are_stopped():
    assert len({step.name for step in STEPS}) == len(STEPS)
    for step in STEPS:
        assert step.will
        assert "Ctrl-C" in step.stop
