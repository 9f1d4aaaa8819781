"""A cut feed-forward is taken with the section that is printed for it, however many digits its limit has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from hil.app.configuration.configuration import load
from hil.app.configuration.feedforward_file import learned_forces, read_feedforward
from hil.app.learn.command import Knowledge, learned
from hil.app.learn.report import written
from hil.config.feedforward import FeedforwardSettings
from tests.hil.app.learn.test_learned_from import run_of


def printed(limit_N: float) -> dict[str, Any]:
    """Return the section that is printed for a file."""
    section: dict[str, Any] = yaml.safe_load(written(Path("next.csv"), limit_N)[-1])["feedforward"]
    return section


def taken(folder: Path, text: str, section: dict[str, Any]) -> float:
    """Return the largest force that a run takes of a file and its section."""
    c = load("virtual")
    (folder / "next.csv").write_text(text)
    settings = FeedforwardSettings.model_validate(section)
    forces = learned_forces(settings, c.reference, c.controller, c.platform, folder)
    assert forces is not None
    return float(abs(read_feedforward(text.encode(), "next.csv")[1]).max())


@pytest.mark.parametrize(
    ("limit_N", "peak_N"),
    [
        (1.00006, 1.0),
        (1.00004, 1.0),
        (0.3, 0.3),
        (4.35, 4.35),
        (4.448222, 4.4482),
        (10.0, 10.0),
        (0.00007, 0.0),
    ],
)
def test_a_run_takes_forces_that_were_cut_at_a_limit_of_any_digits(
    tmp_path: Path, limit_N: float, peak_N: float
) -> None:
    outcome = learned([run_of(0)], Knowledge(limit_N=limit_N))
    assert outcome.cut > 0
    assert taken(tmp_path, outcome.text, printed(limit_N)) == peak_N
    assert taken(tmp_path, outcome.text, {"file": "next.csv", "limit_N": limit_N}) == peak_N


@pytest.mark.parametrize("force_N", [22241.11, 25000.0, 3000.3, 123456.789, 0.7])
def test_the_printed_limit_of_a_share_of_the_drives_force_is_that_of_the_file(
    tmp_path: Path, force_N: float
) -> None:
    """Without section feedforward it is a fifth of limits.force_N."""
    c = load("virtual")
    limits = c.limits.model_copy(update={"force_N": force_N})
    c = c.model_copy(update={"limits": limits})
    run = run_of(0, c=c)
    run = run._replace(trial=run.trial._replace(e=1e4 * run.trial.e))
    outcome = learned([run], Knowledge())
    assert outcome.cut > 0
    section = printed(0.2 * force_N)
    assert section["limit_N"] == pytest.approx(0.2 * force_N, rel=1e-14)
    assert taken(tmp_path, outcome.text, section) == pytest.approx(0.2 * force_N, abs=1.01e-4)
