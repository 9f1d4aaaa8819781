"""When the commands of a simulation are given: in the first tick at or after their time, each once; and what is said
of those that are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.app.sim.commands import CommandScript, read_commands
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


@pytest.mark.parametrize("skipped", [10, 39])
def test_a_command_whose_tick_is_skipped_is_given_in_the_next_one(skipped: int) -> None:
    script = CommandScript([(0.0045, "stop")], 1000.0)
    assert script(4).operator == ()
    assert script(skipped).operator == (Operator.STOP,)
    assert script(skipped + 1).operator == ()
    assert script.left == 0


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.01, 1), (0.02, 1), (0.03, 2), (0.06, 3), (0.14, 7), (0.28, 14), (0.29, 15), (0.56, 28)],
)
def test_a_repeated_command_is_sent_every_20_ms_until_its_end(seconds: float, words: int) -> None:
    script = CommandScript([(1.0, f"jog x 1 for {seconds}")], 1000.0)
    assert [tick for tick in range(2000) if script(tick).orders] == [1000 + 20 * k for k in range(words)]


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["none", "byte order mark"])
@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["unix", "windows"])
def test_a_file_of_commands_is_read_whatever_editor_wrote_it(tmp_path: Path, mark: str, end: str) -> None:
    lines = ["0.5 start # at last", "", "# a remark", "  2  jog x 1 for 1.5 ", "1e1\thold"]
    (tmp_path / "c.txt").write_bytes((mark + end.join(lines) + end).encode())
    assert [(t, " ".join(word.split())) for t, word in read_commands(tmp_path / "c.txt")] == [
        (0.5, "start"), (2.0, "jog x 1 for 1.5"), (10.0, "hold"),
    ]  # fmt: skip
