"""Learning in lockstep: run, learn, repeat; and logs that cannot be learned from."""

from __future__ import annotations

import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import hil
from drivers.errors import LogError
from drivers.signals import Fault, Mode, Warn
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.feedforward_file import read_feedforward
from hil.app.replay import replay_log
from hil.cli import main
from hil.lab.identify.runs import recorded_run
from hil.lab.learn import runs
from hil.lab.learn.command import Knowledge, Series, learn, rehearse, with_scale
from hil.lab.learn.runs import learning_run
from hil.record.log import Log

SHORT = {
    "type": "waypoints",
    "interpolation": "quintic",
    "periods": 1,
    "points": [
        {"t_s": 0, "position_m": [0, 0, 1]},
        {"t_s": 0.5, "position_m": [0.03, -0.04, 1.05], "rotation_vector_deg": [2, 3, -2]},
    ],
}


def short(**sections: Any) -> Configuration:
    c = load("virtual")
    text = with_changes(c.text, {"name": "short", "reference": SHORT} | sections)
    return with_scale(loads(text, "short.yaml", c.folder), 0.9)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Series]:
    """Four runs with a law whose masses are a tenth too small."""
    folder = tmp_path_factory.mktemp("learn")
    return folder, rehearse(short(), 4, Knowledge(), folder, lambda _: None)


def log(folder: Path, number: int) -> Path:
    return folder / f"short-run-{number:02d}.mcap"


def told(*arguments: Any) -> Any:
    return CliRunner(env={"COLUMNS": "200"}).invoke(main, ["learn", *map(str, arguments)])


def test_log_contains_the_learned_forces_and_replays_without_their_file(made, tmp_path):
    folder, _ = made
    alone = tmp_path / "alone.mcap"
    shutil.copy(log(folder, 2), alone)
    table = folder / "short-run-02.csv"
    _, tau, start_s, _ = read_feedforward(table.read_bytes(), "csv")
    table.rename(tmp_path / "moved.csv")
    try:
        comparison, summary = replay_log(alone)
    finally:
        (tmp_path / "moved.csv").rename(table)
    assert comparison.exact
    assert summary["agrees"]
    rows = Log.open(alone).rows()
    tracking = rows[rows["mode"] == Mode.TRACKING]
    at = np.rint((tracking["reference_time_s"] - start_s) / 1e-3).astype(int)
    within = at < len(tau)
    np.testing.assert_allclose(tracking["tau_learned"][within], tau[at[within]], atol=1e-6)
    whole = tracking["tau_law"] + tracking["tau_learned"]
    np.testing.assert_allclose(tracking["tau"], whole, atol=1e-9)
    assert np.abs(tracking["tau_learned"]).max() > 100.0
    moving = rows[(rows["mode"] >= Mode.APPROACH) & (rows["mode"] <= Mode.PARKING)]
    assert np.abs(np.diff(moving["tau_learned"], axis=0)).max() < 60.0, "no bump"
    assert np.abs(moving["tau_learned"][-1]).max() > 100.0
    unloading = rows[rows["mode"] == Mode.UNLOADING]
    assert not unloading["tau_learned"].any()
    assert np.abs(unloading["tau"][0] - moving["tau"][-1]).max() < 1.0, (
        "the holding force takes over the learned force without a step"
    )


def test_learning_command_on_one_log_gives_the_same_forces_as_the_automatic_series(made, tmp_path):
    folder, _ = made
    out = tmp_path / "next.csv"
    result = told(log(folder, 0), "-o", out)
    assert result.exit_code == 0, result.output
    assert out.read_text() == (folder / "short-run-01.csv").read_text()
    assert "feedforward: {file: next.csv, limit_N: 5000}" in result.output
    again = told(log(folder, 0), log(folder, 1), "-o", out, "--json", tmp_path / "a.json")
    assert again.exit_code == 0, again.output
    assert read_feedforward(out.read_bytes(), "next.csv")[0].run == 2, (
        "an earlier file of its own is replaced"
    )


def spoiled(rows: Any, **columns: Any) -> Any:
    """Rows with columns changed from half of the reference on."""
    other = rows.copy()
    along = np.flatnonzero(other["mode"] == Mode.TRACKING)
    for name, value in columns.items():
        other[name][along[250] :] = value
    return other


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"faults": int(Fault.FOLLOWING)}, r"ended in a fault \(FOLLOWING\)"),
        ({"mode": int(Mode.STOPPING)}, "250 of 500 ticks along the reference"),
        ({"reference_time_s": 0.25}, "differs from the clock's"),
        ({"warnings": int(Warn.FORCE_STEP)}, r"limits cut the forces at 250 ticks"),
    ],
)
def test_log_with_a_fault_stop_hold_or_limit_is_refused_for_learning(made, columns, said, monkeypatch):
    path = log(made[0], 0)
    recorded = recorded_run(path)
    along = recorded.rows[: np.flatnonzero(recorded.rows["mode"] == Mode.TRACKING)[499] + 1]
    monkeypatch.setattr(runs, "recorded_run", lambda _: recorded._replace(rows=spoiled(along, **columns)))
    with pytest.raises(LogError, match=said):
        learning_run(path)


@pytest.mark.long
def test_ten_iterative_learning_runs_reduce_the_tracking_error_twentyfold(tmp_path):
    """The book's path on the bus, with masses of the law at 0.9 of the robot's."""
    found = rehearse(with_scale(load("virtual"), 0.9), 10, Knowledge(), tmp_path, lambda _: None)
    assert not found.trouble
    first, last = found.steps[0], found.steps[-1]
    assert first.rms_mm > 1.0
    assert first.rms_mm / last.rms_mm >= 20.0
    assert first.peak_mm / last.peak_mm >= 10.0
    rms = [step.rms_mm for step in found.steps]
    assert all(after <= max(before, 1.1 * min(rms)) for before, after in pairwise(rms))
    assert found.outcome is not None
    assert found.outcome.state == "floor"


@pytest.mark.long
def test_learned_feedforward_forces_fade_out_when_a_hold_command_interrupts_the_run(made, tmp_path):
    folder, _ = made
    c = Log.open(log(folder, 2)).configuration
    (tmp_path / "c.yaml").write_text(c)
    found = hil.sim(tmp_path / "c.yaml", log=tmp_path / "held.mcap", commands=[(1.4, "hold"), (2.4, "start")])
    assert found.success
    rows = found.log.rows("t_ns", "mode", "tau_learned")
    late = rows["t_ns"] > rows["t_ns"][0] + 1_500_000_000
    assert not rows["tau_learned"][late].any()
    assert np.abs(rows["tau_learned"]).max() > 100.0
    assert np.abs(np.diff(rows["tau_learned"], axis=0)).max() < 60.0
    with pytest.raises(LogError, match="differs from the clock's"):
        learn([tmp_path / "held.mcap"], Knowledge())
