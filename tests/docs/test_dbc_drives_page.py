"""The guide on drives by a DBC: its mappings are those of the examples, which run and are replayed elsewhere."""

import re
from pathlib import Path
from shutil import copy

import pytest
import yaml

from drivers.protocol import EXTENDED
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.lab.bringup.command import run_bringup

DOCS = Path(__file__).resolve().parents[2] / "docs"
EXAMPLE, TIMED = (DOCS / f"examples/drives/{name}.yaml" for name in ("rmd", "vesc"))
PAGE = (DOCS / "guides/dbc-drives.md").read_text(encoding="utf-8")


def test_mappings_of_the_guide_are_those_of_the_examples():
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    for block, example in zip(blocks, (EXAMPLE, TIMED), strict=True):
        given = yaml.safe_load(block)["drives"]
        assert given == {key: yaml.safe_load(example.read_text("utf-8"))["drives"][key] for key in given}


@pytest.mark.parametrize("example", [EXAMPLE, TIMED], ids=lambda path: path.stem)
def test_example_runs_and_its_log_is_replayed_without_the_files(example, tmp_path):
    folder, log = tmp_path / "here", tmp_path / "run.mcap"
    folder.mkdir()
    for file in (example, example.with_suffix(".dbc")):
        copy(file, folder)
    summary = simulate(load(folder / example.name), log=log, duration_s=2.0, check_replay=False)
    assert summary["success"], summary["trouble"]
    assert summary["rejected_frames"] == summary["stale_ticks"] == 0
    for file in folder.iterdir():
        file.unlink()
    assert replay_log(log)[0].exact


@pytest.mark.parametrize(
    ("example", "mistakes", "found"),
    [(EXAMPLE, [], []), (TIMED, [], []), (TIMED, ["force_sign leg=2"], ["force_sign"])],
)
def test_bring_up_of_an_example_finds_mistakes_and_leaves_the_delay_unproven(
    example, mistakes, found, tmp_path
):
    for file in (example, example.with_suffix(".dbc")):
        copy(file, tmp_path)
    name, log = str(tmp_path / example.name), tmp_path / "run.mcap"
    summary = run_bringup(name, load(name), mistakes=mistakes, yes=True, say=lambda _: None, log=log)
    assert [each.partition(":")[0] for each in summary["findings"]] == found
    assert summary["success"] == (not found)
    assert found or "is rounded by up to 0." in summary["not_provable"][1]


def test_bus_budget_counts_the_messages_of_a_timer_that_a_tick_may_have():
    c = load(TIMED)
    (budget,) = bus_budgets(c.bus, c.drives, c.sensors, 200.0)
    assert budget.frames == {(4, EXTENDED): 6, (8, EXTENDED): 15}, "12 every 4 ms, in ticks of 5 ms"


def test_bus_budget_counts_the_answers_to_commands():
    frames = []
    for answers in (True, False):
        text = with_changes(EXAMPLE.read_text("utf-8"), {"drives": {"options": {"answers_command": answers}}})
        c = loads(text, "rmd", EXAMPLE.parent)
        (budget,) = bus_budgets(c.bus, c.drives, c.sensors, 200.0)
        frames.append(sum(budget.frames.values()))
    assert frames == [24, 18]
