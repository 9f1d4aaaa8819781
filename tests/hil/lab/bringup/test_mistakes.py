"""Every wiring mistake is named with its legs, and nothing else is: each on some drive families, by a fixed design."""

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.rehearsal import mistake_of
from plant_fmu.rehearsal.wiring import OWN, OWN_BRAKES, Mistake, Wiring, wired
from tests.hil.lab.bringup.families import FAMILIES
from tests.hil.lab.bringup.kit import Rehearsal, named


def swapped(values: tuple[Any, ...], i: int, j: int) -> tuple[Any, ...]:
    """Exchange two of the values."""
    found = list(values)
    found[i], found[j] = values[j], values[i]
    return tuple(found)


_CASES: dict[str, str | tuple[Wiring, set[tuple[str, tuple[int, ...]]]]] = {
    "swapped_ids": (wired(Mistake("ids_swapped", 1, 4)), {("ids", (1, 4))}),
    "rotated_ids": (wired(Mistake("ids_rotated", 0, 2, 5)), {("ids", (0, 2, 5))}),
    "encoder_sign": "encoder_sign leg=3",
    "encoder_twice": "encoder_scale leg=0 value=2.0",
    "encoder_half": "encoder_scale leg=5 value=0.5",
    "encoder_1_percent": "encoder_scale leg=2 value=1.01",
    "encoder_less_1_percent": "encoder_scale leg=4 value=0.99",
    "force_sign": "force_sign leg=1",
    "force_half": "force_scale leg=4 value=0.5",
    "force_twice": "force_scale leg=2 value=2.0",
    "no_force": (wired(Mistake("force_scale", 3, value=0.0)), {("no_force", (3,))}),
    "lead_10_for_8": "wrong_lead leg=1 value=1.25",
    "drive_reversed": "drive_reversed leg=0",
    "brake_stuck_shut": "brake_stuck_shut leg=2",
    "brake_stuck_open": "brake_stuck_open leg=4",
    "brake_weak": (wired(Mistake("brake_weak", 1, value=2e-4)), {("brake_stuck_open", (1,))}),
    "brakes_crossed": "brake_crossed leg=0 other=3",
    "encoders_crossed": "encoder_crossed leg=2 other=5",
    "motors_crossed": "motor_crossed leg=1 other=3",
    "no_watchdog": "watchdog_missing leg=4",
    "slow_watchdog": "watchdog_long leg=0",
    "watchdog_twice": "watchdog_long leg=5 value=2.5",
    "fast_watchdog": "watchdog_short leg=1",
    "homed_4_mm_off": "offset leg=3",
    "homed_less_2_mm_off": "offset leg=0 value=-0.002",
    "two_with_one_id": "same_id leg=5 other=2",
    "leg_absent": "absent leg=3",
    "wrong_protocol": "wrong_protocol leg=1",
    "encoder_frozen": "encoder_frozen leg=5",
    "encoder_counts_another": "encoder_counts_another leg=0 other=4",
    "mounted_elsewhere": (
        wired(Mistake("mounted_elsewhere", 1, 2)),
        {("mounted_elsewhere", (1,)), ("mounted_elsewhere", (2,))},
    ),
    "stroke_of_all": (Wiring(shorter=(0.1,) * 6), {("stroke", (0, 1, 2, 3, 4, 5))}),
    "friction": "friction leg=2",
    "friction_beyond_2_percent": "friction leg=4 value=0.03",
    "end_stop": "end_stop leg=3",
    "rate_of_the_other_sign": "rate_sign leg=2",
    "rate_in_another_unit": "rate_scale leg=3",
    "dead_rate": "rate_scale leg=5 value=0.0",
    "force_one_way": "force_one_way leg=1",
    "weak_supply": "force_saturates leg=4",
    "brake_inverted": "brake_inverted leg=2",
    "platform_ends": (
        wired(Mistake("platform_end_elsewhere", 1, 2)),
        {("mounted_elsewhere", (1,)), ("mounted_elsewhere", (2,))},
    ),
    "payload": (wired(Mistake("payload", 0)), {("payload", ())}),
    "ceiling": (wired(Mistake("upside_down", 0)), {("gravity", ())}),
    "counts_a_tenth": "encoder_scale leg=2 value=0.09",
    "counts_ten_times": "encoder_scale leg=2 value=10.0",
    "swapped_and_reversed": (
        wired(Mistake("encoder_sign", 2), Mistake("ids_swapped", 1, 4)),
        {("ids", (1, 4)), ("encoder_sign", (2,))},
    ),
    "offset_and_friction": (
        replace(Wiring(), offset_m=(0.0, 6e-3, 0.0, 0.0, 0.0, 0.0), friction=(0.0,) * 5 + (0.01,)),
        {("offset", (1,)), ("friction", (5,))},
    ),
}
"""What is wired wrongly, and what is named; of one mistake in words, its own name and legs."""


def case_of(words: str) -> tuple[Wiring, set[tuple[str, tuple[int, ...]]]]:
    mistake = mistake_of(words)
    legs = {mistake.leg, mistake.other, mistake.third} - {-1}
    return wired(mistake), {(mistake.name, tuple(sorted(legs)))}


CASES = {case: case_of(what) if isinstance(what, str) else what for case, what in _CASES.items()}
COMBINED = {
    "ids_swapped_and_its_encoder_reversed": (
        wired(Mistake("ids_swapped", 1, 4), Mistake("encoder_sign", 4)),
        {("ids", (1, 4)), ("encoder_sign", (4,))},
    ),
    "force_and_brake": (
        wired(Mistake("force_sign", 5), Mistake("brake_stuck_shut", 0)),
        {("force_sign", (5,)), ("brake_stuck_shut", (0,))},
    ),
    "encoders_and_brakes_of_the_same_two": (
        replace(Wiring(), encoder=swapped(OWN, 2, 3), brake=swapped(OWN_BRAKES, 2, 3)),
        {("ids", (2, 3)), ("motor_crossed", (2, 3))},  # the same as exchanged drives with crossed motors
    ),
    "motors_and_encoders_of_the_same_two": (
        replace(Wiring(), encoder=swapped(OWN, 0, 5), motor=swapped(OWN, 0, 5)),
        {("encoder_crossed", (0, 5))},
    ),
    "two_pairs_of_drives": (
        wired(Mistake("ids_swapped", 0, 1), Mistake("ids_swapped", 2, 3)),
        {("ids", (0, 1, 2, 3))},
    ),
    "two_absent": (
        wired(Mistake("absent", 1), Mistake("absent", 4)),
        {("absent", (1,)), ("absent", (4,))},
    ),
    "same_id_and_an_encoder": (
        wired(Mistake("same_id", 5, 2), Mistake("encoder_sign", 0)),
        {("same_id", (2, 5))},
    ),
    "encoder_stops_half_way": (wired(Mistake("encoder_stops", 0)), {("encoder_jumps", (0,))}),
}
"""Several mistakes at once, and rare ones: on our own drives alone."""
UNWATCHED = ("cubemars", "mini_cheetah", "robstride")
"""Families without a watchdog that is set from here."""
OTHERWISE: dict[tuple[str, str], set[tuple[str, tuple[int, ...]]] | None] = {
    **{
        (family, case): None
        for family in UNWATCHED
        for case in ("no_watchdog", "slow_watchdog", "fast_watchdog", "watchdog_twice")
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
    # its frames carry 1.6 times the stroke: beyond it a drive's answer is no length
    ("damiao", "counts_ten_times"): {("not_heard", (2,))},
}
"""What is named otherwise than with our own drives; None: no such mistake can be."""
TWO = ("virtual", "damiao")
"""Our own drives, and motors that are polled: for the mistakes of `SIZES`."""
SIZES = {
    *("encoder_less_1_percent", "brake_weak", "watchdog_twice", "homed_less_2_mm_off", "stroke_of_all"),
    *("friction_beyond_2_percent", "counts_ten_times", "swapped_and_reversed", "offset_and_friction"),
}


def design() -> list[tuple[str, str]]:
    """Pairs of family and mistake: each mistake on three or four families, those with the fewest so far."""
    pairs = [(family, case) for case in CASES if case in SIZES for family in TWO]
    for k, case in enumerate(case for case in CASES if case not in SIZES):
        many = Counter(family for family, _ in pairs)
        can = [family for family in FAMILIES if OTHERWISE.get((family, case), True)]
        pairs += [(family, case) for family in sorted(can, key=many.__getitem__)[: 3 + k % 2]]
    return pairs + [("virtual", case) for case in COMBINED]


@pytest.mark.long
@pytest.mark.parametrize(("family", "case"), design())
def test_mistake_is_named_with_its_legs(family, case):
    wiring, expected = (CASES | COMBINED)[case]
    rehearsal = Rehearsal(family, wiring)
    outcome = rehearsal.run()
    assert named(outcome) == (OTHERWISE.get((family, case)) or expected)
    assert rehearsal.watched.most_open <= 1
    # one code of torque is 0.44 N of leg force at the coarsest of these drives
    assert rehearsal.watched.most_force_N <= 0.02 * rehearsal.machine.rated_N + 0.45
    assert all(finding.mend for finding in outcome.findings)


EARLY = [
    ("legs_classic", "encoder_sign leg=3", 4),
    ("cia402_difference", "watchdog_missing leg=2", 2),
    ("robstride", "encoder_counts_another leg=1 other=4", 3),
    ("desktop", "watchdog_missing leg=2", 2),
    ("virtual", "encoder_scale leg=2 value=1.01", 4),
    ("virtual", "encoder_jumps leg=5", 4),
    ("virtual", "brake_stuck_open leg=4", 5),
    ("virtual", "rate_sign leg=2", 5),
    ("virtual", "brake_inverted leg=1", 5),
    ("virtual", "force_one_way leg=1", 6),
    ("virtual", "force_saturates leg=4", 7),
]


@pytest.mark.parametrize(("name", "mistake", "steps"), EARLY)
def test_step_that_looks_for_a_mistake_names_it(name, mistake, steps):
    wiring, expected = case_of(mistake)
    rehearsal = Rehearsal(name, wiring)
    assert named(rehearsal.run(STEPS[:steps])) == expected
    assert rehearsal.watched.most_open <= 1


def test_bus_on_which_nobody_answers_has_six_absent_drives():
    rehearsal = Rehearsal("virtual", replace(Wiring(), present=(False,) * 6))
    assert named(rehearsal.run(STEPS[:4])) == {("absent", tuple(range(6)))}


SEEDS = [
    *((name, 1 + k % 3) for k, name in enumerate([*FAMILIES, "lab"])),
    *(("virtual", k) for k in (2, 3, 4)),
]


@pytest.mark.long
@pytest.mark.parametrize(("family", "seed"), SEEDS)
def test_good_machine_has_no_finding_whatever_the_errors_of_tape_and_gauge(family, seed):
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
def test_platform_that_is_not_the_configured_one_is_named_while_it_hangs(mistake, name, legs):
    rehearsal = Rehearsal("virtual", wired(mistake))
    assert named(rehearsal.run(STEPS[-1:])) == {(name, legs)}
    assert rehearsal.watched.opened_while_hung == 0
