"""The log of a run of a series that failed: named where it is kept, and how it is kept where it is not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from hil.app.configuration.configuration import Configuration
from hil.cli import main
from hil.lab.learn import rehearsal
from hil.lab.learn.runs import LearningRun
from tests.hil.lab.learn.test_learned_from import run_of

CANNOT_TEACH = "run.mcap: has a hold"
WHY = [("the plant stopped", [], "the plant stopped"), (None, ["FOLLOWING", "FORCE"], "FOLLOWING, FORCE")]
"""Trouble and faults of a run, and how both are told."""


@pytest.fixture(params=[0, 1], ids="run {}".format)
def failing(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Let this run of a series fail; return its number and what takes trouble and faults of it."""
    logs: list[Path] = []
    why: dict[str, Any] = {}

    def simulate(_: Configuration, *, log: Path, **__: Any) -> dict[str, Any]:
        log.touch()
        logs.append(log)
        return {"success": len(logs) <= request.param} | why

    monkeypatch.setattr(rehearsal, "refuse_unreachable", lambda _: None)
    monkeypatch.setattr(rehearsal, "simulate", simulate)
    monkeypatch.setattr(rehearsal, "learning_run", lambda _: run_of(len(logs) - 1))
    return request.param, why


def told(folder: Path, *arguments: str) -> tuple[str, str]:
    """Return the line by which a series says why it ended, and the same of its JSON."""
    found = folder / "found.json"
    runner = CliRunner(env={"COLUMNS": "400"})
    result = runner.invoke(main, ["learn", "virtual", "--runs", "3", "--json", str(found), *arguments])
    assert result.exit_code == 1, result.output
    (line,) = (line for line in result.output.splitlines() if line.startswith("Stopped"))
    return line, json.loads(found.read_text())["trouble"]


@pytest.mark.parametrize(("trouble", "faults", "why"), WHY)
def test_a_log_that_is_not_kept_is_not_named_and_how_to_keep_it_is_said(
    failing: Any, tmp_path: Path, trouble: str | None, faults: list[str], why: str
) -> None:
    number, given = failing
    given.update(trouble=trouble, faults=faults)
    said = f"run {number}: {why}; its log is not kept, --logs FOLDER keeps it"
    assert told(tmp_path) == (f"Stopped    {said}", said)


@pytest.mark.parametrize(("trouble", "faults", "why"), WHY)
def test_a_log_that_is_kept_is_named_with_its_folder(
    failing: Any, tmp_path: Path, trouble: str | None, faults: list[str], why: str
) -> None:
    number, given = failing
    given.update(trouble=trouble, faults=faults)
    log = tmp_path / f"virtual-run-0{number}.mcap"
    said = f"run {number}: {why}; its log is {log}"
    assert told(tmp_path, "--logs", str(tmp_path)) == (f"Stopped    {said}", said)
    assert log.exists()


@pytest.fixture(params=[0, 1], ids="run {}".format)
def cannot_teach(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Let the log of this run of a series be one that nothing is learned from; return its number."""
    number: int = request.param
    read: list[Path] = []

    def learning_run(log: Path) -> LearningRun:
        read.append(log)
        if len(read) > number:
            raise LogError(CANNOT_TEACH)
        return run_of(len(read) - 1)

    monkeypatch.setattr(rehearsal, "refuse_unreachable", lambda _: None)
    monkeypatch.setattr(rehearsal, "simulate", lambda *_, **__: {"success": True})
    monkeypatch.setattr(rehearsal, "learning_run", learning_run)
    return number


@pytest.mark.parametrize("kept", [True, False])
def test_of_a_log_that_cannot_teach_it_is_said_whether_it_is_kept(
    cannot_teach: int, tmp_path: Path, kept: bool
) -> None:
    said = CANNOT_TEACH if kept else f"{CANNOT_TEACH}; that log is not kept, --logs FOLDER keeps it"
    arguments = ["learn", "virtual", "--runs", "3", *(["--logs", str(tmp_path)] if kept else [])]
    result = CliRunner(env={"COLUMNS": "400"}).invoke(main, arguments)
    lines = result.output.splitlines()
    if cannot_teach:
        assert f"Stopped    run {cannot_teach}: {said}" in lines
    else:
        assert lines == [f"hil: {said}"]
