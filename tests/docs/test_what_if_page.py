"""The commands in the guide on what-if, comparisons and log folders run in their order."""

import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli import main

PAGE = (Path(__file__).parents[2] / "docs/guides/what-if.md").read_text()


@pytest.mark.long
def test_commands_of_the_what_if_guide_run_in_their_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    lines = block.splitlines()
    assert len(lines) == 7
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "hil"
        done = CliRunner().invoke(main, words)
        assert done.exit_code == 0, (line, done.output)
    assert {path.name for path in tmp_path.iterdir()} >= {"run-plot.png", "answer.mcap", "replay.xml"}
