"""Commands in front of obstacles, as their users start them; what the judge sees, in this process."""

from __future__ import annotations

import os

import pytest

from tools.impatience.child import Outcome
from tools.obstacles.__main__ import rows
from tools.obstacles.commands import COMMANDS
from tools.obstacles.meet import REFUSED_S, Met, Scene, found
from tools.obstacles.obstacles import OBSTACLES


def outcome(code: int, err: str, wall_s: float = 1.0) -> Outcome:
    return Outcome(code, "", err, (), wall_s, wall_s)


@pytest.mark.parametrize(
    ("end", "obstacle", "wrong"),
    [
        (outcome(2, "hil: runs: is a file and no folder; name another file\n"), "runs_file", []),
        (outcome(2, ""), "runs_file", ["says nothing", "does not say why", "refuses in 0 lines, not in one"]),
        (outcome(2, "hil: a\nb\n"), "runs_file", ["refuses in 2 lines, not in one"]),
        (outcome(2, "hil: a\n", REFUSED_S + 5.0), "runs_file", ["refuses after 20 s"]),
        (outcome(1, "Traceback (most recent call last)\n"), "runs_file", ["says 'Traceback'", "does not say why"]),
        (outcome(2, "hil: a\n"), "none", ["does not even work with nothing in the way"]),
        (outcome(-9, "hil: a\n"), "disk_full", ["exit code -9, allowed: 0, 1, 2"]),
    ],
)  # fmt: skip
def test_the_judge_sees_each_thing_that_is_wrong(end, obstacle, wrong, tmp_path):
    assert found(end, tmp_path, OBSTACLES[obstacle]) == wrong


def test_the_table_has_a_row_for_each_thing_that_is_said():
    cases = [
        Met("sim", "runs_file", outcome(2, "hil: /tmp/hil-obstacles-x/sim-runs_file/work/runs: is a file\n"), []),
        Met("check", "runs_file", outcome(0, ""), []),
        Met("run", "runs_file", outcome(2, "hil: runs: is a file\n"), []),
    ]  # fmt: skip
    assert list(rows(cases))[2:] == ["| `runs` is a file | check | sim, run: 2 | runs: is a file |"]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene(tmp_path_factory.mktemp("scene"))


@pytest.mark.long
@pytest.mark.skipif(os.geteuid() != 0, reason="some obstacles need root to be put there")
@pytest.mark.parametrize(
    "command",
    [pytest.param(each, marks=pytest.mark.realtime if each == "run" else ()) for each in COMMANDS],
)
def test_a_command_says_in_one_line_what_is_in_its_way(scene: Scene, command: str):
    met = [scene.meet(command, obstacle) for obstacle in OBSTACLES]
    assert [(each.obstacle, each.wrong) for each in met if each.wrong] == []
