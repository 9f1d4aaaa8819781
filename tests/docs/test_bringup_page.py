"""What the page on the bring-up quotes of a rehearsal is what it says."""

import re
import shlex
from pathlib import Path

from click.testing import CliRunner

from hil.cli import main

PAGE = (Path(__file__).parents[2] / "docs/guides/bringup.md").read_text()


def test_the_finding_on_the_page_is_the_one_of_its_rehearsal(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (command,) = re.findall(r"^hil (bringup virtual --rehearse --yes --mistake .*)$", PAGE, re.MULTILINE)
    (quoted,) = re.findall(r"```text\n(.*?)\n```", PAGE, re.DOTALL)
    done = CliRunner().invoke(main, shlex.split(command))
    assert done.exit_code == 1, done.output
    assert quoted in done.output.splitlines()
