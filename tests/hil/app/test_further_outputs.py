"""An output that cannot be written when the work is done: the figures are there, it is named, exit code 1."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import load
from hil.app.output import fail, further
from hil.app.sim.command import simulate
from hil.cli import main
from hil.lab.identify import axes
from hil.study.compare import command as compare
from hil.study.compare.measure import Outcome
from hil.study.workspace import command as workspace
from tests.hil.lab.test_calibrate_command import rows, write

FULL = "No space left on device"


@pytest.fixture
def full_disk(monkeypatch):
    """A disk on which there is room for a summary alone."""
    replace = Path.replace

    def full(self, target):
        if Path(target).suffix != ".json":
            raise OSError(errno.ENOSPC, FULL)
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", full)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "a.mcap"
    simulate(load("ideal"), log=path, duration_s=0.1, check_replay=False)
    return path


def test_what_goes_wrong_later_does_not_hide_what_went_wrong_before():
    summary: dict[str, Any] = {"success": True, "trouble": None}
    for why in ("", "the recorder stopped", "the picture failed"):
        fail(summary, why)
    assert summary == {"success": False, "trouble": "the recorder stopped; the picture failed"}


@pytest.mark.parametrize("success", [True, False])
def test_each_output_that_fails_is_named_and_the_work_is_no_success_and_not_lost(success):
    summary: dict[str, Any] = {"success": success, "figure": 7}
    with further(summary):
        summary["one"] = 1
    assert summary == {"success": success, "figure": 7, "one": 1}
    errors = [
        OSError(errno.ENOSPC, FULL, "a.png"),
        LogError("--junit b.xml: cannot be written"),
        ConfigurationError("c.yaml: cannot be written"),
        OSError(errno.EIO, "it says"),
    ]
    for error in errors:
        with further(summary):
            raise error
    said = [
        f"a.png: {FULL}",
        "--junit b.xml: cannot be written",
        "c.yaml: cannot be written",
        "it says",
    ]
    assert summary == {"success": False, "figure": 7, "one": 1, "unwritten": said}


def test_a_mistake_in_the_program_is_no_output_that_fails():
    with pytest.raises(ZeroDivisionError), further({}):
        raise ZeroDivisionError


def hil(folder, *words):
    """Return what a command said, and its summary."""
    result = CliRunner().invoke(main, [*map(str, words), "--json", str(folder / "a.json")])
    assert result.exit_code == 1, result.output
    return result, json.loads((folder / "a.json").read_text())


@pytest.fixture
def undrawn(monkeypatch):
    """A function that lets a command's picture meet a full disk."""

    def full(*_):
        raise OSError(errno.ENOSPC, FULL, "a.png")

    return lambda command: monkeypatch.setattr(command, "draw", full)


def test_a_comparison_keeps_its_laws(tmp_path, monkeypatch, undrawn):
    undrawn(compare)
    outcome = Outcome("inverse_dynamics", compare.OWN, None, None, {"peak_leg_error_mm": 0.3}, {})
    monkeypatch.setattr(compare, "perform", lambda *_: [outcome])
    monkeypatch.setattr(compare, "_shares", lambda *_: {})
    monkeypatch.setattr(compare, "judge", lambda _: [])
    ideal, law = load("ideal"), ["inverse_dynamics"]
    found = compare.compare(ideal, laws=law, path_laws=(), duration_s=0.05, picture=tmp_path / "a.png")
    assert found["laws"]["inverse_dynamics"]["peak_leg_error_mm"] == 0.3
    assert (found["success"], found["picture"], found["unwritten"]) == (False, None, [f"a.png: {FULL}"])


def test_a_workspace_keeps_its_figures(tmp_path, monkeypatch, undrawn):
    undrawn(workspace)
    for name, stand_in in {"build_surveyor": None, "explore": None, "figures": {"volume": 7}}.items():
        monkeypatch.setattr(workspace, name, lambda *_, it=stand_in: it)
    found = workspace.map_workspace(load("lab"), picture=tmp_path / "a.png")
    assert (found["volume"], found["success"]) == (7, False)
    assert (found["picture"], found["unwritten"]) == (None, [f"a.png: {FULL}"])


def test_axes_whose_picture_cannot_be_drawn_keep_their_model(tmp_path, monkeypatch, undrawn):
    undrawn(axes)
    monkeypatch.setattr(axes, "write_section", lambda *_: None)
    files: Any = axes.Outputs(tmp_path / "a.yaml", tmp_path / "a.png")
    identified: Any = SimpleNamespace(model=None)
    assert axes.save(identified, files, "a") == {
        "model": str(tmp_path / "a.yaml"),
        "picture": None,
        "success": False,
        "unwritten": [f"a.png: {FULL}"],
    }


def test_the_replay_of_a_folder_keeps_its_cases(tmp_path, log, full_disk):
    words = ("--suite", log.parent, "--jobs", "1", "--junit", tmp_path / "a.xml")
    result, found = hil(tmp_path, "replay", *words)
    assert (found["passed"], found["success"]) == (1, False)
    assert f"hil: --junit {tmp_path / 'a.xml'}: cannot be written: {FULL}" in result.stderr


def test_a_what_if_keeps_its_answer(tmp_path, log, monkeypatch):
    def full(_, path, __):
        raise LogError(f"--plot {path}: cannot be written: {FULL}")

    monkeypatch.setattr("hil.study.what_if.command.Forces.draw", full)
    words = (log, "--set", "limits.force_N=1e5", "--plot", tmp_path / "a.png")
    result, found = hil(tmp_path, "replay", *words)
    assert found["ticks"] > 50
    assert found["picture"] is None
    assert f"--plot {tmp_path / 'a.png'}: cannot be written: {FULL}" in result.stderr


def test_a_calibration_keeps_its_fit_and_shows_the_joints_that_it_could_not_write(tmp_path, full_disk):
    poses = write(tmp_path / "poses.csv", rows())
    out = tmp_path / "joints.yaml"
    result, found = hil(tmp_path, "calibrate", "lab", poses, "--out", out)
    assert not out.exists()
    assert found["unwritten"] == [f"{out}: {FULL}"]
    assert "base_joints_m" in result.stdout


def test_a_matrix_of_faults_keeps_its_cases(tmp_path, monkeypatch, full_disk):
    case = {"kind": "encoder_jump", "when": "TRACKING", "given": "leg 2", "success": True, "verdict": "good"}
    matrix = [case | {"fault": "encoder_jump leg=2", "wall_s": 1.0}]
    summary = {"success": True, "kind": "faults", "configuration": "ideal", "matrix": matrix, "wall_s": 1.0}
    monkeypatch.setattr("hil.study.faults.command.run_matrix", lambda *_, **__: summary)
    _, found = hil(tmp_path, "faults", "ideal", "--junit", tmp_path / "a.xml")
    assert found["matrix"] == matrix
    assert found["unwritten"] == [f"--junit {tmp_path / 'a.xml'}: cannot be written: {FULL}"]


class Plan:
    """What the command asks of a campaign."""

    name, folder = "payload", Path("rows")

    def __len__(self):
        return 500


def test_a_campaign_keeps_its_summary_though_neither_page_nor_report_can_be_written(
    tmp_path, monkeypatch, full_disk
):
    summary = {"success": True, "kind": "campaign", "rows": 500}
    monkeypatch.setattr("hil.study.campaign.command.run_campaign", lambda *_, **__: dict(summary))

    def page(path, *_):
        raise LogError(f"{path}: cannot be written: {FULL}")

    monkeypatch.setattr("hil.study.campaign.page.write_page", page)
    monkeypatch.setattr("hil.study.campaign.plan.read_plan", lambda _: Plan())
    stand_ins: dict[str, Any] = {"show": None, "summary_lines": summary, "verdicts": []}
    for name, stand_in in stand_ins.items():
        monkeypatch.setattr(f"hil.study.campaign.show.{name}", lambda *_, it=stand_in: it)
    words = ("payload", "--out", tmp_path / "rows", "--junit", tmp_path / "a.xml")
    result, found = hil(tmp_path, "campaign", *words)
    assert (found["rows"], found["success"], "page" in found) == (500, False, False)
    assert [line.partition(": cannot")[0] for line in result.stderr.splitlines()[-2:]] == [
        f"hil: {tmp_path / 'rows' / 'report.html'}",
        f"hil: --junit {tmp_path / 'a.xml'}",
    ]


def test_learned_forces_that_cannot_be_written_are_not_said_to_be(tmp_path, monkeypatch, full_disk):
    outcome = SimpleNamespace(text="t_s", steps=[SimpleNamespace(run=None)])
    named: list[object] = []
    monkeypatch.setattr("hil.lab.learn.command.learn", lambda *_: outcome)
    monkeypatch.setattr("hil.lab.learn.command.limit_of", lambda *_: 1.0)

    def lines(_, __, out):
        named.append(out)
        return ["Filter"]

    def summary(_, out):
        named.append(out)
        return {"success": True, "kind": "learn"}

    monkeypatch.setattr("hil.lab.learn.report.lines", lines)
    monkeypatch.setattr("hil.lab.learn.report.summary", summary)
    result, found = hil(tmp_path, "learn", tmp_path / "a.mcap", "-o", tmp_path / "n.csv")
    assert named == [None, None]
    assert found["unwritten"] == [f"{tmp_path / 'n.csv'}: {FULL}"]
    assert "Filter" in result.stdout
