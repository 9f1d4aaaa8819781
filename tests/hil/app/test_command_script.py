"""When the commands of a simulation are given: in the first tick at or after their time, each once; and what is said
of those that are refused."""

from __future__ import annotations

import pytest

from hil.app.sim.commands import CommandScript
from hil.signals import Operator


def given(rate_Hz: float, *times_s: float, ticks: int = 40) -> list[int]:
    """Return in which ticks a stop that is to come at each of these times is given."""
    script = CommandScript([(t, "stop") for t in times_s], rate_Hz)
    return [tick for tick in range(ticks) for each in script(tick).operator if each is Operator.STOP]


@pytest.mark.parametrize(
    ("rate_Hz", "t_s", "tick"),
    [
        (1000.0, 0.0, 0),
        (1000.0, 0.007, 7),
        (1000.0, 0.0071, 8),
        (1000.0, 0.0075, 8),
        (1000.0, 0.0079, 8),
        (400.0, 0.0175, 7),
        (400.0, 0.0176, 8),
        (400.0, 0.0001, 1),
        (3000.0, 0.007, 21),
        (3000.0, 0.0071, 22),
    ],
)
def test_a_command_is_given_in_the_first_tick_at_or_after_its_time(
    rate_Hz: float, t_s: float, tick: int
) -> None:
    assert given(rate_Hz, t_s) == [tick]


def test_commands_between_the_same_two_ticks_are_given_together_each_once() -> None:
    assert given(1000.0, 0.0121, 0.0049, 0.0129, 0.0131) == [5, 13, 13, 14]


@pytest.mark.parametrize("skipped", [10, 39])
def test_a_command_whose_tick_is_skipped_is_given_in_the_next_one(skipped: int) -> None:
    script = CommandScript([(0.0045, "stop")], 1000.0)
    assert script(4).operator == ()
    assert script(skipped).operator == (Operator.STOP,)
    assert script(skipped + 1).operator == ()
    assert script.left == 0


def test_what_was_refused_is_told_of_its_command_whatever_the_kinds_in_a_tick() -> None:
    words = ["start", "arm", "setpoint 0 0 1", "reset", "hold", "setpoint 0 0 2"]
    script = CommandScript([(0.0, word) for word in words], 1000.0)
    script(0)
    assert script.answered(["no arm", ""], ["", "no hold"], ["of a file", "no first", "no second"]) == [
        "no arm", "no first", "no hold", "no second",
    ]  # fmt: skip
    assert script.refused == 4
    script(1)
    assert script.answered([], [], ["of a file"]) == []


def test_a_repeated_command_is_refused_once_and_each_new_reason_is_told_and_each_after_it_was_taken() -> None:
    script = CommandScript([(0.0, "jog x 1 for 0.12"), (0.05, "hold"), (0.2, "jog x 1 for 0.02")], 1000.0)
    told = []
    for tick, why in ((0, "a"), (20, "a"), (40, "b"), (60, ""), (80, "b"), (100, "b"), (200, "b")):
        if tick == 60:
            script(50)
            assert script.answered([], [""], []) == []
        assert script(tick).orders
        told.append(script.answered([], [why], []))
    assert told == [["a"], [], ["b"], [], ["b"], [], ["b"]]
    assert script.refused == 2
    assert script.left == 0
