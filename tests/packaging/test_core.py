"""A plain `pip install hexapod-hil`: the loop runs without the packages of the extras."""

import subprocess
import sys

import pytest

WITHOUT = """
import sys

sys.modules |= dict.fromkeys(("scipy", "sympy", "flint", "matplotlib", "rich", "pandas", "pyarrow"))
from hil.cli import main
main(sys.argv[1:])
"""


def hil(folder, *words):
    command = [sys.executable, "-c", WITHOUT, *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_check_sim_replay_and_report_run_without_the_optional_extras(tmp_path):
    for words in (
        ["check", "virtual"],
        ["sim", "virtual", "--duration", "0.1", "--log", "a.mcap"],
        ["replay", "a.mcap"],
        ["report", "a.mcap"],
    ):
        done = hil(tmp_path, *words)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("words", [["workspace", "virtual"], ["design", "hinf", "hinf"]])
def test_command_that_needs_a_missing_extra_fails_with_the_extra_to_install(tmp_path, words):
    done = hil(tmp_path, *words)
    assert done.returncode == 2
    assert "hexapod-hil[full]" in done.stderr
