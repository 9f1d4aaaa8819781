"""The story of an encoder that is doubted: which leg strayed, and that a brake may be the cause."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Doubt, Fault, Mode
from tests.hil.cycle_bench import Bench
from tests.hil.test_story import SECTIONS, Case, legs, strike, told


@pytest.fixture(scope="module")
def moving() -> Bench:
    bench = Bench()
    bench.until(Mode.APPROACH)
    return bench


def story_of(bench: Bench, doubt: Doubt, **columns):
    """Let leg 3 be doubted by 30 um beyond 20; legs stray as said, in m, since its standstill began."""
    bench.cycle.faults, bench.cycle.mode = Fault.NONE, Mode.APPROACH
    kept, memory = bench.cycle.tick, bench.cycle.parts.safety.memory.copy()
    shown = {"legs_doubted": 8, "doubt": int(doubt), "doubt_value": 3e-5, "doubt_limit": 2e-5}
    began = np.full((6, 6), 9.0)
    began[3] = 1e-5
    try:
        case = Case(Fault.ENCODER, {**shown, "q_d": 1.5, **columns}, [], (), {"began": began})
        return told(strike(bench, case)[0])
    finally:
        bench.cycle.tick, bench.cycle.parts.safety.memory[()] = kept, memory


@pytest.mark.parametrize(
    ("lengths", "age", "which"),
    [
        (legs(1.50001, leg_3=1.50004, leg_5=1.50002), legs(0), "while its reference moved on by"),
        (legs(1.50001, leg_3=1.50002, leg_5=1.49998), legs(0), "while leg 5 strayed from its reference by"),
        (
            legs(1.50001, leg_0=1.4, leg_1=1.50004),
            legs(0, leg_0=1),
            "while leg 1 strayed from its reference by",
        ),
    ],
)
def test_a_leg_that_stands_still_is_told_with_the_one_leg_that_strayed(moving, lengths, age, which):
    story = story_of(moving, Doubt.STILL, length=lengths, age=age)
    assert f"leg 3 stands still, {which} 0.030 mm" in story.short
    assert "another leg" not in story.short


def test_a_brake_is_among_the_causes_of_what_it_looks_like(moving):
    still = story_of(moving, Doubt.STILL, length=1.5, age=0)
    assert "its encoder is frozen, or its brake did not open or has closed" in still.short
    jump = story_of(moving, Doubt.JUMP)
    assert "its encoder jumped, or its rate is wrong" in jump.short
    leap = story_of(moving, Doubt.LEAP)
    assert "its encoder, its brake closed, or a force along this leg" in leap.short
    for story in (still, jump):
        (advice,) = story.next
        assert "brake" in advice
        assert "noisy state monitor.length_noise_m" in advice
    causes = SECTIONS["Fault ENCODER"].split("Likely causes")[1].split("What to do")[0]
    assert "brake" in causes
    assert "`monitor.length_noise_m`" in causes


@pytest.mark.parametrize(
    ("pushed", "told_"),
    [
        (legs(0.0), ""),
        (legs(0.0, leg_1=38.0), "; leg 1 was being pushed by +38 N, to see whether it moves"),
        (legs(0.0, leg_1=38.0, leg_4=-7.0), "; leg 1 was being pushed by +38 N, leg 4 by -7 N, to see"),
    ],
)
def test_a_leg_that_does_not_follow_is_told_with_the_pushes_of_its_tick(moving, pushed, told_):
    bench = moving
    bench.cycle.faults, bench.cycle.mode = Fault.NONE, Mode.APPROACH
    kept, memory = bench.cycle.tick, bench.cycle.parts.safety.memory.copy()
    columns = {"q": 1.4, "q_d": legs(1.4, leg_2=1.4131), "dq_d": 0.0, "dq": 0.0, "probe_force": pushed}
    try:
        story = told(strike(bench, Case(Fault.FOLLOWING, columns, [], ()))[0])
    finally:
        bench.cycle.tick, bench.cycle.parts.safety.memory[()] = kept, memory
    assert (
        f"leg 2 is 13.10 mm from its reference, at its speed limits.following_error_m allows 10.00 mm{told_}"
        in story.short
    )
    assert ("pushed" in story.short) == bool(told_)
