"""The file of a series with --inertia-scale belongs to a law with these masses: that is said, with the key to set."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.feedforward_file import feedforward_text, made_for
from hil.cli import main
from hil.lab.learn import rehearsal
from hil.lab.learn.command import Knowledge, learned
from hil.lab.learn.rehearsal import Rehearsal
from tests.hil.lab.learn.test_learned_from import T, head_of, run_of


@pytest.fixture
def series(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a series end with a file of the controller that it ran with, without a run."""
    outcome = learned([run_of(0), run_of(1, 0.5)], Knowledge())

    def rehearse(c: Configuration, *_: Any, **__: Any) -> Rehearsal:
        prints = made_for(c.reference, c.controller, c.platform, c.folder)
        text = feedforward_text(head_of(1, rows=10, made_for=prints), np.zeros((10, 6)), -4, T)
        return Rehearsal(outcome.steps, outcome, 300.0, text, "", interrupted=False)

    monkeypatch.setattr(rehearsal, "rehearse", rehearse)


def told(source: Path, *arguments: str) -> str:
    """Return what a series says, with a file best.csv beside its configuration."""
    out = str(source.parent / "best.csv")
    runner = CliRunner(env={"COLUMNS": "400"})
    result = runner.invoke(main, ["learn", str(source), "--runs", "2", "-o", out, *arguments])
    assert result.exit_code == 0, result.output
    return result.output


def configured(folder: Path, believed: float) -> Path:
    path = folder / "mine.yaml"
    change = {"name": "mine", "controller": {"model": {"inertia_scale": believed}}}
    path.write_text(with_changes(load("virtual").text, change))
    return path


@pytest.mark.usefixtures("series")
@pytest.mark.parametrize(
    ("believed", "scale"), [(1.0, "0.9"), (0.8, "1.1"), (0.7, "0.1"), (1.2, "0.333333333333")]
)
def test_the_section_is_taken_with_the_masses_that_are_said_and_refused_with_those_of_the_file(
    tmp_path: Path, believed: float, scale: str
) -> None:
    path = configured(tmp_path, believed)
    said = told(path, "--inertia-scale", scale)
    section = yaml.safe_load(next(line for line in said.splitlines() if line.startswith("feedforward:")))
    with pytest.raises(ConfigurationError, match="was learned on another controller"):
        loads(with_changes(path.read_text(), section), "mine.yaml", tmp_path)
    keys = re.findall(r"controller\.model\.inertia_scale: (\S+) ", said)
    assert [float(key) for key in keys] == [pytest.approx(believed * float(scale), rel=1e-12)]
    both = section | {"controller": {"model": {"inertia_scale": float(keys[0])}}}
    assert loads(with_changes(path.read_text(), both), "mine.yaml", tmp_path).feedforward is not None


@pytest.mark.usefixtures("series")
def test_the_section_of_a_series_with_the_masses_of_its_file_is_taken_as_it_is_and_no_more_is_said(
    tmp_path: Path,
) -> None:
    path = configured(tmp_path, 0.8)
    last = told(path).splitlines()[-1]
    assert last == "feedforward: {file: best.csv, limit_N: 300}"
    c = loads(with_changes(path.read_text(), yaml.safe_load(last)), "mine.yaml", tmp_path)
    assert c.feedforward is not None
