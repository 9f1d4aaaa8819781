"""Each block of the guide on drives, pasted into a configuration from `hil new`, works."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner

from drivers.mit.fields import VARIANTS
from drivers.registry import registered
from hil.app.check.command import inspect
from hil.app.configuration.configuration import loads
from hil.app.sim.command import simulate
from hil.cli import main
from tests.broad import broad

PAGE = (Path(__file__).resolve().parents[2] / "docs/guides/drives.md").read_text(encoding="utf-8")
SECTION = PAGE[PAGE.index("## Into your configuration") : PAGE.index("## Motor and leg")]


def family(block: str) -> str:
    drives = yaml.safe_load(block)["drives"]
    return str(drives.get("options", {}).get("variant", drives["protocol"]))


BLOCKS = {family(block): block for block in re.findall(r"```yaml\n(.*?)```", SECTION, re.DOTALL)}
ROBOT = (
    "--base-radius 0.35 --platform-radius 0.25 --length-min 0.5 --stroke 0.2 --mass 42 --leg-mass 4 "
    "--drive-force 800 --drive-speed 0.3 --reflected-mass 5 --yes"
)


def sections(text: str) -> dict[str, str]:
    """Top sections of a YAML text by name, unchanged."""
    return {
        found.group(1): found.group()
        for found in re.finditer(r"^(\w+):.*\n(?:(?:[ #].*)?\n)*", text, re.MULTILINE)
    }


@pytest.fixture(scope="module")
def new(tmp_path_factory):
    """Text of a new robot's configuration: our own protocol at 1 kHz on CAN FD."""
    file = tmp_path_factory.mktemp("new") / "my.yaml"
    assert CliRunner().invoke(main, ["new", str(file), *ROBOT.split()]).exit_code == 0
    return file.read_text(encoding="utf-8")


def pasted(text: str, block: str) -> str:
    there = sections(text)
    for name, section in sections(block).items():
        text = text.replace(there[name], section + "\n") if name in there else f"{text}\n{section}"
    return text


def test_guide_on_drives_has_a_yaml_block_for_every_drive_family():
    assert set(BLOCKS) == set(registered("hil.protocols")) - {"legs", "mit", "dbc"} | set(VARIANTS)


@pytest.mark.parametrize("name", broad(BLOCKS, quick=2))
def test_yaml_block_of_the_guide_on_drives_pasted_into_a_new_configuration_passes_check(name, new):
    c = loads(pasted(new, BLOCKS[name]), f"{name}.yaml")
    assert c.drives.protocol == yaml.safe_load(BLOCKS[name])["drives"]["protocol"]
    told = inspect(c).warnings
    assert all(text.startswith("drives.") or "SCHED_FIFO" in text for text in told), told


@pytest.mark.parametrize("name", broad(BLOCKS, quick=1))
def test_new_robot_with_a_yaml_block_of_the_guide_on_drives_tracks_parks_and_replays(name, new, tmp_path):
    c = loads(pasted(new, BLOCKS[name]), f"{name}.yaml")
    summary = simulate(c, log=tmp_path / "run.mcap", duration_s=3.0)
    assert summary["success"], summary
    assert summary["final_mode"] == "PARKED"
    assert summary["replay"]["agrees"]
    assert summary["tracking"]["peak_leg_error_mm"] < 0.6
