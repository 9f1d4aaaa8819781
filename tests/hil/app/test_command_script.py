"""When the commands of a simulation are given: in the first tick at or after their time, each once."""

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
