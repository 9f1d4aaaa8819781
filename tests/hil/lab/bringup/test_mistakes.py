"""Every wiring mistake is named, with its legs, before the platform is released, and nothing else is."""

from dataclasses import replace

import pytest

from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named

CASES = {
    "swapped_ids": (wired(Mistake("ids_swapped", 1, 4)), {("ids", (1, 4))}),
    "swapped_neighbours": (wired(Mistake("ids_swapped", 0, 1)), {("ids", (0, 1))}),
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
    "gear_2": (wired(Mistake("wrong_lead", 5, value=0.5)), {("wrong_lead", (5,))}),
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
    "leg_0_absent": (wired(Mistake("absent", 0)), {("absent", (0,))}),
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
    "two_mistakes": (
        wired(Mistake("force_sign", 0), Mistake("encoder_scale", 3, value=1.02)),
        {("force_sign", (0,)), ("encoder_scale", (3,))},
    ),
    "swapped_and_reversed": (
        wired(Mistake("encoder_sign", 2), Mistake("ids_swapped", 1, 4)),
        {("ids", (1, 4)), ("encoder_sign", (2,))},
    ),
    "offset_and_friction": (
        replace(Wiring(), offset_m=(0.0, 6e-3, 0.0, 0.0, 0.0, 0.0), friction=(0.0,) * 5 + (0.01,)),
        {("offset", (1,)), ("friction", (5,))},
    ),
}

ELSEWHERE = {("desktop", "counts_ten_times"): {("not_heard", (2,))}}
"""Its frames carry 1.6 times the stroke: beyond it a drive's answer is no length."""


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ["virtual", "desktop"])
def test_a_mistake_is_named_with_its_legs(name, case):
    wiring, expected = CASES[case]
    expected = ELSEWHERE.get((name, case), expected)
    rehearsal = Rehearsal(name, wiring)
    outcome = rehearsal.run()
    assert named(outcome) == expected
    assert rehearsal.watched.most_open <= 1
    # mit truncates: one code of torque is 0.24 N of leg force on this machine
    assert rehearsal.watched.most_force_N <= 0.02 * rehearsal.machine.rated_N + 0.25
    assert all(finding.mend for finding in outcome.findings)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2, 7))
@pytest.mark.parametrize("name", ["virtual", "desktop", "lab"])
def test_a_good_machine_has_no_findings_whatever_the_errors_of_tape_and_gauge(name, seed):
    rehearsal = Rehearsal(name, Wiring(), seed=seed)
    outcome = rehearsal.run()
    assert outcome.success, outcome.findings
    assert rehearsal.watched.most_travel_m < 1e-3
