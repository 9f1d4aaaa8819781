"""A controller that ends in the middle of `hil ctl key`, `jog` or `hil setpoint`: what was said stays known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Self

import pytest
from click.testing import CliRunner, Result

from drivers.errors import RunError
from hil.app import operate, setpoint
from hil.app.configuration.configuration import load
from hil.cli import main
from hil.operate.client import Answer

LIVE = """reference:
  type: live
  limits: {velocity_m_s: 0.3, velocity_deg_s: 20, acceleration_m_s2: 1, acceleration_deg_s2: 60, jerk_m_s3: 10, jerk_deg_s3: 600}

"""
Said = Callable[..., tuple[Result, Path]]


class Ending:
    """Answers so many lines, and has ended then; refuses the second one where it is to."""

    def __init__(self, answers: int, *, refuses: bool = False) -> None:
        self._left, self._refuses = answers, refuses
        self.heard: list[str] = []

    def say(self, line: str) -> Answer:
        if not self._left:
            raise RunError("the controller did not answer: has it ended?")
        self._left -= 1
        self.heard.append(line)
        return Answer(not (self._refuses and len(self.heard) == 2), "too far")

    def key(self) -> None:
        self.say("key")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """There is nothing to give back."""


@pytest.fixture
def said(tmp_path, monkeypatch) -> Said:
    """Give a command to a controller that ends; return the result and the file of its summary."""
    text = load("virtual").text
    first, last = text.index("\nreference:") + 1, text.index("\nlimits:") + 1
    (tmp_path / "my.yaml").write_text(text[:first] + LIVE + text[last:])
    monkeypatch.setattr(operate, "REPEAT_S", 0.0)

    def said(words: str, controller: Ending, lines: str = "") -> tuple[Result, Path]:
        for module in (operate, setpoint):
            monkeypatch.setattr(module, "OperatorClient", lambda *_: controller)
        name, *more = words.split()
        given = [name, str(tmp_path / "my.yaml"), *more, "--json", str(tmp_path / "a.json")]
        return CliRunner().invoke(main, given, input=lines), tmp_path / "a.json"

    return said


@pytest.mark.parametrize("words", ["ctl key", "ctl jog x 1", "ctl jog leg3 -0.5 --for 9"])
def test_a_controller_that_ends_meanwhile_is_a_failure_whose_summary_says_how_often_it_heard(said, words):
    result, file = said(words, Ending(3))
    assert result.exit_code == 1
    summary = json.loads(file.read_text())
    assert (summary["success"], summary["sent"]) == (False, 3)
    assert "has it ended?" in summary["trouble"]
    assert summary["trouble"] in result.stderr


def test_a_controller_that_ends_before_it_hears_that_a_jog_is_over_is_a_failure_too(said, monkeypatch):
    instants = iter([0.0, 0.1, 0.2, 9.0])
    clock = SimpleNamespace(monotonic=lambda: next(instants), sleep=lambda _: None)
    monkeypatch.setattr("hil.app.operate.time", clock)
    controller = Ending(2)
    result, file = said("ctl jog x 1 --for 1", controller)
    assert result.exit_code == 1
    assert controller.heard == ["jog x 1"] * 2
    assert json.loads(file.read_text())["sent"] == 2


@pytest.mark.parametrize("refuses", [False, True])
def test_set_points_that_were_taken_before_the_controller_ended_are_counted(said, refuses):
    lines = "0 0 1\n0 0 1.1\n\n0 0 1.2\n0 0 1.3\n0 0 1.4\n"
    result, file = said("setpoint", Ending(3, refuses=refuses), lines)
    assert result.exit_code == 1
    summary = json.loads(file.read_text())
    assert summary["success"] is False
    assert (summary["sent"], summary["taken"]) == (4, 3 - refuses)
    assert summary["refused"] == ["0 0 1.1: too far"] * refuses
    assert summary["trouble"].startswith("0 0 1.3: the controller did not answer")
    assert summary["trouble"] in result.stderr


@pytest.mark.parametrize("words", ["ctl key", "ctl jog x 1", "setpoint"])
def test_a_controller_that_answers_nothing_at_all_is_refused_with_2_and_leaves_no_summary(said, words):
    result, file = said(words, Ending(0), "0 0 1\n0 0 1.1\n")
    assert result.exit_code == 2
    assert "has it ended?" in result.stderr
    assert not file.exists()
