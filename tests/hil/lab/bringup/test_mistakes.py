"""Every wiring mistake is named with its legs, and nothing else is: each on some drive families, by a fixed design."""

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from hil.lab.bringup.procedure import STEPS
from plant_fmu.rehearsal.wiring import OWN, OWN_BRAKES, Mistake, Wiring, wired
from tests.hil.lab.bringup.families import FAMILIES
from tests.hil.lab.bringup.kit import Rehearsal, named


def swapped(values: tuple[Any, ...], i: int, j: int) -> tuple[Any, ...]:
    """Exchange two of the values."""
    found = list(values)
    found[i], found[j] = values[j], values[i]
    return tuple(found)


CASES = {
    "swapped_ids": (wired(Mistake("ids_swapped", 1, 4)), {("ids", (1, 4))}),
    "rotated_ids": (wired(Mistake("ids_rotated", 0, 2, 5)), {("ids", (0, 2, 5))}),
    "encoder_sign": (wired(Mistake("encoder_sign", 3)), {("encoder_sign", (3,))}),
    "encoder_twice": (wired(Mistake("encoder_scale", 0, value=2.0)), {("encoder_scale", (0,))}),
    "encoder_half": (wired(Mistake("encoder_scale", 5, value=0.5)), {("encoder_scale", (5,))}),
    "encoder_1_percent": (wired(Mistake("encoder_scale", 2, value=1.01)), {("encoder_scale", (2,))}),
    "encoder_less_1_percent": (wired(Mistake("encoder_scale", 4, value=0.99)), {("encoder_scale", (4,))}),
    "force_sign": (wired(Mistake("force_sign", 1)), {("force_sign", (1,))}),
    "force_half": (wired(Mistake("force_scale", 4, value=0.5)), {("force_scale", (4,))}),
    "force_twice": (wired(Mistake("force_scale", 2, value=2.0)), {("force_scale", (2,))}),
    "no_force": (wired(Mistake("force_scale", 3, value=0.0)), {("no_force", (3,))}),
    "lead_10_for_8": (wired(Mistake("wrong_lead", 1, value=1.25)), {("wrong_lead", (1,))}),
    "drive_reversed": (wired(Mistake("drive_reversed", 0)), {("drive_reversed", (0,))}),
    "brake_stuck_shut": (wired(Mistake("brake_stuck_shut", 2)), {("brake_stuck_shut", (2,))}),
    "brake_stuck_open": (wired(Mistake("brake_stuck_open", 4)), {("brake_stuck_open", (4,))}),
    "brake_weak": (wired(Mistake("brake_weak", 1, value=2e-4)), {("brake_stuck_open", (1,))}),
    "brakes_crossed": (wired(Mistake("brake_crossed", 0, 3)), {("brake_crossed", (0, 3))}),
    "encoders_crossed": (wired(Mistake("encoder_crossed", 2, 5)), {("encoder_crossed", (2, 5))}),
    "motors_crossed": (wired(Mistake("motor_crossed", 1, 3)), {("motor_crossed", (1, 3))}),
    "no_watchdog": (wired(Mistake("watchdog_missing", 4)), {("watchdog_missing", (4,))}),
    "slow_watchdog": (wired(Mistake("watchdog_long", 0)), {("watchdog_long", (0,))}),
    "watchdog_twice": (wired(Mistake("watchdog_long", 5, value=2.5)), {("watchdog_long", (5,))}),
    "fast_watchdog": (wired(Mistake("watchdog_short", 1)), {("watchdog_short", (1,))}),
    "homed_4_mm_off": (wired(Mistake("offset", 3)), {("offset", (3,))}),
    "homed_less_2_mm_off": (wired(Mistake("offset", 0, value=-2e-3)), {("offset", (0,))}),
    "two_with_one_id": (wired(Mistake("same_id", 5, 2)), {("same_id", (2, 5))}),
    "leg_absent": (wired(Mistake("absent", 3)), {("absent", (3,))}),
    "wrong_protocol": (wired(Mistake("wrong_protocol", 1)), {("wrong_protocol", (1,))}),
    "encoder_frozen": (wired(Mistake("encoder_frozen", 5)), {("encoder_frozen", (5,))}),
    "encoder_counts_another": (
        wired(Mistake("encoder_counts_another", 0, 4)),
        {("encoder_counts_another", (0, 4))},
    ),
    "mounted_elsewhere": (
        wired(Mistake("mounted_elsewhere", 1, 2)),
        {("mounted_elsewhere", (1,)), ("mounted_elsewhere", (2,))},
    ),
    "stroke_of_all": (Wiring(shorter=(0.1,) * 6), {("stroke", (0, 1, 2, 3, 4, 5))}),
    "friction": (wired(Mistake("friction", 2)), {("friction", (2,))}),
    "friction_beyond_2_percent": (wired(Mistake("friction", 4, value=0.03)), {("friction", (4,))}),
    "end_stop": (wired(Mistake("end_stop", 3)), {("end_stop", (3,))}),
    "rate_of_the_other_sign": (wired(Mistake("rate_sign", 2)), {("rate_sign", (2,))}),
    "rate_in_another_unit": (wired(Mistake("rate_scale", 3)), {("rate_scale", (3,))}),
    "dead_rate": (wired(Mistake("rate_scale", 5, value=0.0)), {("rate_scale", (5,))}),
    "force_one_way": (wired(Mistake("force_one_way", 1)), {("force_one_way", (1,))}),
    "weak_supply": (wired(Mistake("force_saturates", 4)), {("force_saturates", (4,))}),
    "brake_inverted": (wired(Mistake("brake_inverted", 2)), {("brake_inverted", (2,))}),
    "platform_ends": (
        wired(Mistake("platform_end_elsewhere", 1, 2)),
        {("mounted_elsewhere", (1,)), ("mounted_elsewhere", (2,))},
    ),
    "payload": (wired(Mistake("payload", 0)), {("payload", ())}),
    "ceiling": (wired(Mistake("upside_down", 0)), {("gravity", ())}),
    "counts_a_tenth": (wired(Mistake("encoder_scale", 2, value=0.09)), {("encoder_scale", (2,))}),
    "counts_ten_times": (wired(Mistake("encoder_scale", 2, value=10.0)), {("encoder_scale", (2,))}),
    "swapped_and_reversed": (
        wired(Mistake("encoder_sign", 2), Mistake("ids_swapped", 1, 4)),
        {("ids", (1, 4)), ("encoder_sign", (2,))},
    ),
    "offset_and_friction": (
        replace(Wiring(), offset_m=(0.0, 6e-3, 0.0, 0.0, 0.0, 0.0), friction=(0.0,) * 5 + (0.01,)),
        {("offset", (1,)), ("friction", (5,))},
    ),
}
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
    ("legs_classic", Mistake("encoder_sign", 3), 4),
    ("cia402_difference", Mistake("watchdog_missing", 2), 2),
    ("robstride", Mistake("encoder_counts_another", 1, 4), 3),
    ("desktop", Mistake("watchdog_missing", 2), 2),
    ("virtual", Mistake("encoder_scale", 2, value=1.01), 4),
    ("virtual", Mistake("encoder_jumps", 5), 4),
    ("virtual", Mistake("brake_stuck_open", 4), 5),
    ("virtual", Mistake("rate_sign", 2), 5),
    ("virtual", Mistake("brake_inverted", 1), 5),
    ("virtual", Mistake("force_one_way", 1), 6),
    ("virtual", Mistake("force_saturates", 4), 7),
]


@pytest.mark.parametrize(("name", "mistake", "steps"), EARLY)
def test_step_that_looks_for_a_mistake_names_it(name, mistake, steps):
    rehearsal = Rehearsal(name, wired(mistake))
    legs = tuple(sorted({mistake.leg, mistake.other} - {-1}))
    assert named(rehearsal.run(STEPS[:steps])) == {(mistake.name, legs)}
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
    rehearsal = Rehearsal(family, Wiring(), seed=seed)
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
