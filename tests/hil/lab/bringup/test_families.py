"""Every drive family: a good machine passes, or says what it cannot prove; each mistake is named with its leg."""

import pytest

from drivers.signals import DriveMode, DriveState
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.lab.bringup.procedure import STEPS
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.broad import broad
from tests.hil.lab.bringup.families import FAMILIES, family
from tests.hil.lab.bringup.kit import Rehearsal, named
from tests.hil.lab.bringup.test_mistakes import CASES

UNWATCHED = ("cubemars", "mini_cheetah", "robstride")
"""Families without a watchdog that is set from here."""
NAMES = (
    "swapped_ids",
    "rotated_ids",
    "encoder_sign",
    "encoder_twice",
    "encoder_half",
    "encoder_1_percent",
    "force_sign",
    "force_half",
    "force_twice",
    "no_force",
    "lead_10_for_8",
    "drive_reversed",
    "brake_stuck_shut",
    "brake_stuck_open",
    "brakes_crossed",
    "encoders_crossed",
    "motors_crossed",
    "no_watchdog",
    "slow_watchdog",
    "fast_watchdog",
    "homed_4_mm_off",
    "two_with_one_id",
    "leg_absent",
    "wrong_protocol",
    "encoder_frozen",
    "encoder_counts_another",
    "mounted_elsewhere",
    "friction",
    "end_stop",
    "rate_of_the_other_sign",
    "rate_in_another_unit",
    "dead_rate",
    "force_one_way",
    "weak_supply",
    "brake_inverted",
    "platform_ends",
    "payload",
    "ceiling",
    "counts_a_tenth",
)
OTHERWISE: dict[tuple[str, str], set[tuple[str, tuple[int, ...]]] | None] = {
    **{
        (family, case): None
        for family in UNWATCHED
        for case in ("no_watchdog", "slow_watchdog", "fast_watchdog")
    },
    **{
        ("cia402_difference", case): None  # the drive sends no rate
        for case in ("rate_of_the_other_sign", "rate_in_another_unit", "dead_rate")
    },
    # shorter than the time between two commands, or heartbeats, of the bring-up: it trips at once
    ("cia402_pdo", "fast_watchdog"): {("not_powered", (1,))},
    ("odrive", "fast_watchdog"): {("not_powered", (1,))},
    # estimates that are sent unasked hide those of a second axis: the number that is missing is named
    ("odrive", "two_with_one_id"): {("absent", (5,))},
}
"""What is named otherwise than with our own drives; None: no such mistake can be."""
POLLED = ["moteus_stopped", *[name for name in FAMILIES if "legs" not in name and name != "moteus_stopped"]]
KNOWN = [(family, case) for family in FAMILIES for case in NAMES if OTHERWISE.get((family, case), True)]


@pytest.mark.parametrize("name", broad(POLLED, quick=1))
def test_brakes_that_act_at_once_open_one_at_a_time(name):
    """An enabling of one tick opens no brake that takes 40 ms: only one that takes none shows it."""
    c, at_once = family(name), {"plant": {"drives": {"brake_open_ms": 0, "brake_close_ms": 0}}}
    rehearsal = Rehearsal(loads(with_changes(c.text, at_once), name, c.folder), Wiring())
    assert rehearsal.run(STEPS[:2]).findings == ()
    assert rehearsal.watched.most_open <= 1


@pytest.mark.long
@pytest.mark.parametrize(("family", "case"), KNOWN)
def test_a_mistake_is_named_with_its_leg_by_every_family(family, case):
    wiring, expected = CASES[case]
    rehearsal = Rehearsal(family, wiring)
    outcome = rehearsal.run()
    assert named(outcome) == (OTHERWISE.get((family, case)) or expected)
    assert rehearsal.watched.most_open <= 1


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("family", FAMILIES)
def test_a_good_machine_has_no_finding_and_its_gap_has_a_name(family, seed):
    rehearsal = Rehearsal(family, Wiring(), seed=seed)
    outcome = rehearsal.run()
    assert outcome.success, outcome.findings
    assert [step for step, _ in outcome.gaps] == ["watchdog"] * (family in UNWATCHED)
    proven = set(outcome.passed) | {step for step, _ in outcome.gaps}
    assert proven == {step.name for step in STEPS}
    assert rehearsal.watched.most_open == 1
    assert rehearsal.watched.most_travel_m < 1e-3


FIRST = {
    "legs_classic": ("encoder_sign", 3, 4),
    "cia402_difference": ("watchdog_missing", 2, 2),
    "robstride": ("encoder_counts_another", 1, 3),
    "odrive": ("watchdog_long", 4, 2),
    "moteus_stopped": ("watchdog_missing", 0, 2),
    "mini_cheetah": ("encoder_scale", 5, 4),
    "cia402_pdo": ("wrong_protocol", 1, 1),
}
"""Mistake, leg, and how many steps it takes to name it."""


@pytest.mark.parametrize("family", broad(FIRST, quick=3))
def test_one_mistake_of_each_family_is_named(family):
    mistake, leg, steps = FIRST[family]
    other = {"other": 4} if mistake == "encoder_counts_another" else {}
    rehearsal = Rehearsal(family, wired(Mistake(mistake, leg, **other)))
    assert named(rehearsal.run(STEPS[:steps])) == {(mistake, tuple(sorted((leg, *other.values()))))}
    assert rehearsal.watched.most_open <= 1


def test_what_is_not_proven_is_accepted_by_a_word_and_has_not_passed():
    rehearsal = Rehearsal("cubemars", Wiring())
    outcome = rehearsal.run(STEPS[:2])
    assert outcome.passed == ("scan",)
    ((step, gap),) = outcome.gaps
    assert step == "watchdog"
    assert "no watchdog that is set from here" in gap.line
    assert "cuts the drives' power" in gap.instead
    assert [(r.act, r.word) for r in rehearsal.hands.requests] == [("accept", "accept")]
    assert rehearsal.watched.most_open == 0


@pytest.mark.parametrize("family", ["cia402_difference", "odrive"])
def test_drives_with_frames_of_their_own_are_powered_alone(family):
    """The five others are commanded off; nothing is locked out, since these drives cannot be."""
    rehearsal = Rehearsal(family, Wiring())
    assert not rehearsal.drives.locks
    rehearsal.run(STEPS[:1])
    assert rehearsal.drives.power(3) == ""
    for _ in range(20):
        rehearsal.drives.step(DriveMode.RUN, 3)
    states = [DriveState(int(s)) for s in rehearsal.bench.nodes.snapshot().state]
    assert states[3] is DriveState.RUN
    assert not {DriveState.READY, DriveState.RUN} & {*states[:3], *states[4:]}


def test_a_brake_is_open_and_shut_for_the_bringup_when_a_slow_heartbeat_has_told_it():
    c = family("odrive")
    slow = with_changes(c.text, {"drives": {"heartbeat_ms": 250}})
    rehearsal = Rehearsal(loads(slow, "odrive", c.folder), Wiring())
    assert not any(rehearsal.drives.prepare(None))
    for leg in (4, 1):
        with rehearsal.context.opened(leg):
            for _ in range(3):
                rehearsal.context.drive(leg)
            assert rehearsal.bench.nodes.snapshot().brake.tolist() == [float(k != leg) for k in range(6)]
    assert rehearsal.bench.nodes.snapshot().brake.all()
    assert rehearsal.watched.most_open == 1
