"""A replay and a what-if build their controller with what the log says of its run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.app import replay
from hil.app.compose import REFERENCE_PLAN
from hil.app.configuration.configuration import load
from hil.app.homing.last_pose import HOMING_JSON
from hil.config.reference import HoldReference
from hil.loop.replay import Comparison
from hil.study.what_if import command

VIRTUAL = load("virtual")
RUN = {"rate_Hz": 500.0, "watchdog_s": 0.025}
FILES = {REFERENCE_PLAN: b"the plan", HOMING_JSON: b"the pose"}


def log_with(files) -> Any:
    return SimpleNamespace(
        path=Path("run.mcap"),
        attachments=files,
        metadata={"summary": {"closed": "clean"}},
        cut="",
        summary=SimpleNamespace(ticks=100),
    )


@pytest.fixture
def built(monkeypatch):
    """With what controllers are built, and which poses are read of which log, in their order."""
    seen: list[Any] = []

    def build_cycle(*given, last_pose):
        seen.append((*given, last_pose))
        return "the cycle"

    for module in (replay, command):
        monkeypatch.setattr(module, "build_cycle", build_cycle)
        monkeypatch.setattr(module, "recorded", lambda path, text: (path, text))
    return seen


@pytest.mark.parametrize("files", [FILES, {}], ids=["with files", "without"])
def test_a_replay_has_the_rate_the_watchdog_the_plan_and_the_pose_of_the_log(monkeypatch, built, files):
    log, path, replayed = log_with(files), Path("run.mcap"), []

    def run(*given):
        replayed.append(given)
        return Comparison(ticks=100)

    monkeypatch.setattr(replay, "open_replayable", lambda _: (log, dict(RUN), VIRTUAL))
    monkeypatch.setattr(replay, "replay", run)
    clock = SimpleNamespace(perf_counter=iter((30.0, 30.5)).__next__)
    monkeypatch.setattr(replay, "time", clock)
    _, found = replay.replay_log(path, print)
    plan, pose = (files.get(name) for name in (REFERENCE_PLAN, HOMING_JSON))
    assert built == [(VIRTUAL, 500.0, 0.025, plan, (path, pose))]
    assert replayed == [(log, "the cycle", print)]
    assert found["times_real_time"] == pytest.approx(100 / 500.0 / 0.5)


def test_a_what_if_has_the_plan_of_the_log_only_for_the_reference_of_the_log(built):
    log, other = log_with(FILES), VIRTUAL.model_copy(update={"reference": HoldReference(type="hold")})
    for own, here in ((VIRTUAL, VIRTUAL), (VIRTUAL, other), (other, other), (other, VIRTUAL)):
        cycle: Any = command._cycle(log, RUN, own, here)
        assert cycle == "the cycle"
    pose = (log.path, b"the pose")
    assert built == [
        (VIRTUAL, 500.0, 0.025, b"the plan", pose),
        (other, 500.0, 0.025, None, pose),
        (other, 500.0, 0.025, b"the plan", pose),
        (VIRTUAL, 500.0, 0.025, None, pose),
    ]
