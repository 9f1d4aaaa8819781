"""When the commands of a simulation are given: in the first tick at or after their time, each once; and what is said
of those that are refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import ConfigurationError
from hil.app.sim import command
from hil.app.sim.commands import CommandScript, read_commands
from hil.signals import Operator, SetPoint


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


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.01, 1), (0.02, 1), (0.03, 2), (0.06, 3), (0.14, 7), (0.28, 14), (0.29, 15), (0.56, 28)],
)
def test_a_word_that_is_repeated_is_said_every_20_ms_and_not_once_more_at_its_end(
    seconds: float, words: int
) -> None:
    script = CommandScript([(1.0, f"jog x 1 for {seconds}")], 1000.0)
    assert [tick for tick in range(2000) if script(tick).orders] == [1000 + 20 * k for k in range(words)]


def test_a_word_that_has_begun_to_be_said_was_reached_and_one_that_has_not_was_not() -> None:
    script = CommandScript([(0.0, "jog x 1 for 0.1"), (0.05, "hold"), (0.06, "start")], 1000.0)
    assert (script.left, script.over) == (3, False)
    script(0)
    assert (script.left, script.over) == (2, False)
    script(50)
    assert (script.left, script.over) == (1, False)
    script(60)
    assert (script.left, script.over) == (0, False)
    script(80)
    assert (script.left, script.over) == (0, True)


def test_the_set_points_of_a_file_come_before_those_of_the_commands_of_their_tick_whose_answers_stay_theirs() -> (
    None
):
    script = CommandScript([(0.0, "setpoint 0 0 1")], 1000.0)
    asked: dict[str, Any] = {}
    told: list[str] = []
    lockstep: Any = SimpleNamespace(
        tick=0, period_ns=1, run=lambda _s, _o, _e, said, **more: asked.update(more, said=said)
    )
    log: Any = SimpleNamespace(event=lambda _t_ns, _level, text: told.append(text))
    of_file, own = SetPoint(9.0, 0.0, 0.0, 0.0, 0.0, 0.0), SetPoint(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    command._run(lockstep, log, None, None, lambda _: (of_file,), script)  # type: ignore[arg-type]
    assert asked["said"](0).setpoints == (of_file, own)
    asked["answered"]([], [], ["of the file", ""])
    assert (told, script.refused) == ([], 0)
    asked["answered"]([], [], ["", "too far"])
    assert (len(told), told[0].endswith("too far"), script.refused) == (1, True, 1)


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["none", "byte order mark"])
@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["unix", "windows"])
def test_a_file_of_commands_is_read_whichever_editor_wrote_it(tmp_path: Path, mark: str, end: str) -> None:
    lines = ["0.5 start # at last", "", "# a remark", "  2  jog x 1 for 1.5 ", "1e1\thold"]
    (tmp_path / "c.txt").write_bytes((mark + end.join(lines) + end).encode())
    assert [(t, " ".join(word.split())) for t, word in read_commands(tmp_path / "c.txt")] == [
        (0.5, "start"), (2.0, "jog x 1 for 1.5"), (10.0, "hold"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "words", [["start"], ["stop", "reset"], ["hold"], ["setpoint 0 0 1"], ["key for 0.1"], []]
)
def test_a_script_lets_the_platform_move_where_it_arms_and_for_no_other_word(words: list[str]) -> None:
    assert not CommandScript([(0.0, word) for word in words], 1000.0).arms
    assert CommandScript([(0.0, word) for word in (*words, "arm")], 1000.0).arms


@pytest.mark.parametrize(
    "word", ["hold for 2", "stop for 1", "arm for 0.1", "setpoint 0 0 1 for 1", "status", "x"]
)
def test_a_word_that_is_not_repeated_or_asks_or_is_none_is_refused_with_its_place(word: str) -> None:
    with pytest.raises(ConfigurationError, match=r"^c: command 2: "):
        CommandScript([(0.0, "hold"), (1.0, word)], 1000.0, "c")


@pytest.mark.parametrize("length", ["0", "-1", "3600.1", "nan", "inf", "soon", ""])
def test_a_word_is_repeated_for_some_time_up_to_an_hour(length: str) -> None:
    with pytest.raises(ConfigurationError, match="allowed: seconds up to 3600"):
        CommandScript([(0.0, f"jog x 1 for {length}")], 1000.0)
