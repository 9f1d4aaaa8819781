"""The output quoted in the guide on bring-up is that of the rehearsal."""

import re
import shlex
from pathlib import Path

from click.testing import CliRunner

from hil.cli import main

PAGE = (Path(__file__).parents[2] / "docs/guides/bringup.md").read_text()


def test_finding_quoted_in_the_bringup_guide_is_printed_by_the_rehearsal_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command, *_ = re.findall(r"^hil (bringup virtual --rehearse --yes --mistake .*)$", PAGE, re.MULTILINE)
    (quoted,) = re.findall(r"```text\n(.*?)\n```", PAGE, re.DOTALL)
    done = CliRunner().invoke(main, shlex.split(command))
    assert done.exit_code == 1, done.output
    assert quoted in done.output.splitlines()
