"""Wiring mistakes are found with their legs and nothing else, several at once, on various drive families."""

from collections import Counter
from dataclasses import replace

import pytest

from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.rehearsal import mistake_of
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.families import FAMILIES
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

Named = set[tuple[str, tuple[int, ...]]]
ROUNDS = {
    "scan": ("absent leg=3", "wrong_protocol leg=1"),
    "number": ("same_id leg=5 other=2",),
    "watchdogs": ("watchdog_missing leg=4", "watchdog_long leg=0", "watchdog_long leg=5 value=2.5"),
    "short": ("watchdog_short leg=1",),
    "ids": ("encoder_frozen leg=5", "encoder_counts_another leg=0 other=4", "encoder_scale leg=2 value=0.09"),
    "signs": (
        *("encoder_sign leg=3", "encoder_scale leg=2 value=1.01", "offset leg=0", "force_sign leg=1"),
        *("brake_stuck_shut leg=5", "force_one_way leg=4"),
    ),
    "scales": (
        *("drive_reversed leg=0", "wrong_lead leg=1", "rate_sign leg=2", "end_stop leg=3"),
        *("force_scale leg=4 value=0.5", "force_saturates leg=5"),
    ),
    "losses": (
        *("friction leg=2", "encoder_scale leg=0 value=2.0", "force_scale leg=3 value=0.0"),
        *("rate_scale leg=5 value=0.0", "force_scale leg=1 value=2.0", "offset leg=4 value=-0.002"),
    ),
    "loose": ("brake_stuck_open leg=4", "brake_inverted leg=2", "brake_weak leg=1 value=2e-4"),
    "crossed": ("ids_swapped leg=1 other=4", "encoder_crossed leg=2 other=5", "brake_crossed leg=0 other=3"),
    "rotated": ("ids_rotated leg=0 other=2 third=5", "motor_crossed leg=1 other=3", "encoder_sign leg=4"),
    "mounted": ("mounted_elsewhere leg=1 other=2", "payload", "upside_down"),
    "ends": ("platform_end_elsewhere leg=1 other=2",),
    "late": ("brake_late leg=2", "encoder_late leg=0", "force_lags leg=4"),
    "slips": ("coupling_slips leg=3",),
    "lost": ("frames_lost",),
}
"""Mistakes that are all found before the bring-up ends at the next gate."""
UNWATCHED = ("cubemars", "mini_cheetah", "robstride")
"""Families without a watchdog that this program sets."""


def case_of(words: str) -> Named:
    """Findings for one mistake: its own name and legs, or others."""
    mistake = mistake_of(words)
    legs = {mistake.leg, mistake.other, mistake.third} - {-1}
    match mistake.name:
        case "ids_swapped" | "ids_rotated":
            return {("ids", tuple(sorted(legs)))}
        case "payload":
            return {("payload", ())}
        case "upside_down":
            return {("gravity", ())}
        case "mounted_elsewhere" | "platform_end_elsewhere":
            return {("mounted_elsewhere", (leg,)) for leg in legs}
        case "frames_lost":
            return {("frames_lost", ())}
        case "brake_weak":
            return {("brake_stuck_open", tuple(legs))}
        case "encoder_late" | "force_lags":
            return {("late_or_lags", tuple(legs))}
        case "coupling_slips":
            return {("coupling_or_clamp", tuple(legs))}
        case "backlash":
            return {("encoder_jumps", tuple(legs))}
        case "force_scale" if mistake.value == 0.0:
            return {("no_force", tuple(legs))}
    return {(mistake.name, tuple(sorted(legs)))}


OTHERWISE: dict[tuple[str, str], Named] = {
    # shorter than the time between two commands, or heartbeats, of the bring-up: it trips at once
    ("cia402_pdo", "short"): {("not_powered", (1,))},
    ("odrive", "short"): {("not_powered", (1,))},
    # estimates that are sent unasked hide those of a second axis: the number that is missing is named
    ("odrive", "number"): {("absent", (5,))},
}
"""Findings that differ from those of the `legs` drives."""


def design() -> list[tuple[str, str]]:
    """Pairs of family and round: each round on two families or more, those with the fewest mistakes so far."""
    pairs, many = list(OTHERWISE), Counter(dict.fromkeys(FAMILIES, 0))
    for name in sorted(ROUNDS, key=lambda each: -len(ROUNDS[each])):
        can = [each for each in many if (each, name) not in OTHERWISE]
        if name in ("watchdogs", "short"):
            can = [each for each in can if each not in UNWATCHED]
        if any("rate" in words for words in ROUNDS[name]):
            can.remove("cia402_difference")  # the drive sends no rate
        for family in sorted(can, key=many.__getitem__)[: {6: 4, 3: 3}.get(len(ROUNDS[name]), 2)]:
            pairs.append((family, name))
            many[family] += len(ROUNDS[name])
    return pairs


def rehearse(family: str, wiring: Wiring, expected: Named) -> None:
    rehearsal = Rehearsal(family, wiring)
    outcome = rehearsal.run()
    assert named(outcome) == expected
    assert rehearsal.watched.most_open <= 1
    # one code of torque is 0.44 N of leg force at the coarsest of these drives
    assert rehearsal.watched.most_force_N <= 0.02 * rehearsal.machine.rated_N + 0.45
    assert all(finding.remedy for finding in outcome.findings)


@pytest.mark.long
@pytest.mark.parametrize(("family", "name"), design())
def test_each_of_several_wiring_mistakes_is_found_with_its_legs(family, name):
    words = ROUNDS[name]
    expected = OTHERWISE.get((family, name)) or Named().union(*map(case_of, words))
    rehearse(family, wired(*map(mistake_of, words)), expected)


ONE_CAUSE: dict[tuple[str, ...], Named] = {
    ("ids_swapped leg=1 other=4", "encoder_sign leg=4"): {("ids", (1, 4)), ("encoder_sign", (4,))},
    # the same as exchanged drives with crossed motors
    ("encoder_crossed leg=2 other=3", "brake_crossed leg=2 other=3"): {
        ("ids", (2, 3)),
        ("motor_crossed", (2, 3)),
    },
    ("encoder_crossed leg=0 other=5", "motor_crossed leg=0 other=5"): {("encoder_crossed", (0, 5))},
    ("ids_swapped leg=0 other=1", "ids_swapped leg=2 other=3"): {("ids", (0, 1, 2, 3))},
    ("wrong_lead leg=1", "brake_stuck_open leg=1"): {("scale_or_lead", (1,)), ("brake_stuck_open", (1,))},
    ("absent leg=1", "absent leg=4"): {("absent", (1,)), ("absent", (4,))},
    ("same_id leg=5 other=2", "encoder_sign leg=0"): {("same_id", (2, 5))},
    ("encoder_stops leg=0",): {("encoder_jumps", (0,))},
    ("encoder_scale leg=2 value=10",): {("encoder_scale", (2,))},
    tuple(f"end_stop leg={leg} value=0.1" for leg in range(6)): {("stroke", (0, 1, 2, 3, 4, 5))},
}
"""Several mistakes with the symptoms of one, or of another."""


@pytest.mark.long
@pytest.mark.parametrize("words", ONE_CAUSE, ids="; ".join)
def test_wiring_mistakes_with_equal_symptoms_are_found_by_their_cause(words):
    rehearse("virtual", wired(*map(mistake_of, words)), ONE_CAUSE[words])


@pytest.mark.long
def test_drive_whose_length_exceeds_the_range_of_its_frame_is_reported_as_not_heard():
    """The range of the frames is 1.6 times the stroke."""
    rehearse("damiao", wired(mistake_of("encoder_scale leg=2 value=10")), {("not_heard", (2,))})


EARLY = [
    ("legs_classic", "encoder_sign leg=3", 4),
    ("cia402_difference", "watchdog_missing leg=2", 2),
    ("robstride", "encoder_counts_another leg=1 other=4", 3),
    ("desktop", "watchdog_missing leg=2", 2),
    ("virtual", "encoder_scale leg=2 value=1.01", 4),
    ("virtual", "encoder_jumps leg=5", 4),
    ("virtual", "backlash leg=2", 4),
    ("virtual", "brake_stuck_open leg=4", 5),
    ("virtual", "brake_late leg=2", 5),
    ("virtual", "frames_lost", 1),
    ("virtual", "rate_sign leg=2", 5),
    ("virtual", "brake_inverted leg=1", 5),
    ("virtual", "force_one_way leg=1", 6),
    ("virtual", "force_saturates leg=4", 7),
]


@pytest.mark.parametrize(("name", "mistake", "steps"), EARLY)
def test_wiring_mistake_is_found_by_the_bring_up_step_that_checks_for_it(name, mistake, steps):
    rehearsal = Rehearsal(name, mistake)
    assert named(rehearsal.run(STEPS[:steps])) == case_of(mistake)
    assert rehearsal.watched.most_open <= 1


def test_silent_bus_is_reported_as_six_absent_drives():
    rehearsal = Rehearsal("virtual", replace(Wiring(), present=(False,) * 6))
    assert named(rehearsal.run(STEPS[:4])) == {("absent", tuple(range(6)))}


SEEDS = [(name, 1 + k % 3) for k, name in enumerate([*FAMILIES, "lab", "virtual"])]


@pytest.mark.long
@pytest.mark.parametrize(("family", "seed"), SEEDS)
def test_good_machine_has_no_finding_despite_errors_of_tape_and_gauge(family, seed):
    rehearsal = Rehearsal(family, seed=seed)
    outcome = rehearsal.run()
    assert outcome.success, outcome.findings
    assert [step for step, _ in outcome.gaps] == ["watchdog"] * (family in UNWATCHED)
    assert set(outcome.passed) | {step for step, _ in outcome.gaps} == {step.name for step in STEPS}
    assert rehearsal.watched.most_open == 1
    assert rehearsal.watched.most_travel_m < 1e-3


@pytest.mark.parametrize(
    ("mistake", "name", "legs"),
    [
        (Mistake("payload", 0, value=0.8), "payload", ()),
        (Mistake("upside_down", 0), "gravity", ()),
        (Mistake("wrong_home", 0), "wrong_home", ()),
        (Mistake("joint_elsewhere", 3), "slipped", (3,)),
    ],
)
def test_platform_that_differs_from_its_configuration_is_found_while_it_hangs(mistake, name, legs):
    rehearsal = Rehearsal("virtual", wired(mistake))
    assert named(rehearsal.run(STEPS[-2:-1])) == {(name, legs)}
    assert rehearsal.watched.opened_while_hung == 0
