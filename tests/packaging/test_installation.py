"""Parts installed once by a user: shell completion, the service, and the commands of the README."""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest

from hil.cli import main as cli

ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "configs/systemd/hil@.service"
PROGRAM = [sys.executable, "-c", "from hil.cli import main; main(prog_name='hil')"]


def completed(shell, words, word):
    environment = {
        **os.environ,
        "_HIL_COMPLETE": f"{shell}_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": word,
    }
    done = subprocess.run(PROGRAM, env=environment, capture_output=True, text=True, timeout=60, check=True)
    return done.stdout


@pytest.mark.parametrize(
    ("shell", "words", "word", "said"),
    [
        ("bash", "hil ch", "1", "plain,check"),
        ("zsh", "hil ch", "1", "plain\ncheck\n"),
        ("fish", "hil ", "ch", "plain,check\t"),
        ("bash", "hil sim la", "2", "plain,lab"),
        ("bash", "hil sim my", "2", "file,my"),
        ("bash", "hil new x --base-r", "3", "plain,--base-radius"),
    ],
)
def test_shell_completion_offers_commands_options_and_configurations_in_each_shell(shell, words, word, said):
    assert said in completed(shell, words, word)


def test_systemd_service_is_stopped_by_a_controlled_stop_without_sigkill():
    unit = configparser.ConfigParser(interpolation=None, strict=False)
    unit.optionxform = str  # type: ignore[assignment, method-assign]
    unit.read(UNIT)
    service = unit["Service"]
    assert (service["KillSignal"], service["KillMode"]) == ("SIGTERM", "mixed")
    assert (service["TimeoutStopSec"], service["SendSIGKILL"], service["Restart"]) == ("infinity", "no", "no")
    assert not unit.has_section("Install")  # no platform moves because a computer was switched on
    assert "--arm" in service["ExecStart"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd")
def test_systemd_accepts_the_shipped_service_unit(tmp_path):
    text = UNIT.read_text().replace("/opt/hil/bin/hil", sys.executable)
    (tmp_path / "hil@.service").write_text(text)
    shown = tmp_path / "hil@my.service"
    shown.write_text(text)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(shown)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    ours = [line for line in done.stderr.splitlines() if "hil@" in line]
    assert ours == []


def test_every_hil_command_of_the_readme_has_its_options():
    """All fenced lines are checked; a renamed option would give the reader a usage error."""
    blocks = (ROOT / "README.md").read_text().split("```")[1::2]
    lines = [line.split("#")[0].split() for block in blocks for line in block.splitlines()]
    called = [words for words in lines if words[:1] == ["hil"]]
    assert len(called) > 20
    for _, name, *words in called:
        command = cli.get_command(click.Context(cli), name)
        assert command is not None, name
        if isinstance(command, click.Group):
            continue
        known = {option for p in command.get_params(click.Context(command)) for option in p.opts}
        assert {w for w in words if w.startswith("-")} <= known, words
