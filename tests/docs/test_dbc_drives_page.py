"""The guide on drives by a DBC: its mapping is that of the example, which runs and is replayed elsewhere."""

import re
from pathlib import Path
from shutil import copy

import yaml

from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate

DOCS = Path(__file__).resolve().parents[2] / "docs"
EXAMPLE = DOCS / "examples/drives/rmd.yaml"
PAGE = (DOCS / "guides/dbc-drives.md").read_text(encoding="utf-8")


def test_mapping_of_the_guide_is_that_of_the_example():
    block = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert block is not None
    given = yaml.safe_load(block.group(1))["drives"]
    assert given == {key: yaml.safe_load(EXAMPLE.read_text("utf-8"))["drives"][key] for key in given}


def test_example_runs_and_its_log_is_replayed_without_the_files(tmp_path):
    folder, log = tmp_path / "here", tmp_path / "run.mcap"
    folder.mkdir()
    for file in (EXAMPLE, EXAMPLE.with_suffix(".dbc")):
        copy(file, folder)
    summary = simulate(load(folder / EXAMPLE.name), log=log, duration_s=2.0, check_replay=False)
    assert summary["success"], summary["trouble"]
    assert summary["rejected_frames"] == summary["stale_ticks"] == 0
    for file in folder.iterdir():
        file.unlink()
    assert replay_log(log)[0].exact


def test_bus_budget_counts_the_answers_to_commands():
    frames = []
    for answers in (True, False):
        text = with_changes(EXAMPLE.read_text("utf-8"), {"drives": {"options": {"answers_command": answers}}})
        c = loads(text, "rmd", EXAMPLE.parent)
        (budget,) = bus_budgets(c.bus, c.drives, c.sensors, 200.0)
        frames.append(sum(budget.frames.values()))
    assert frames == [24, 18]
