"""`controller.law: ./my_law.py:MyLaw`: a law in a file runs, is recorded and replays; a log runs no code."""

import pickle
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

import hil
from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.law_file import UnreadLaw
from hil.app.replay import open_run
from hil.cli import main
from hil.lab.identify.runs import recorded_run

LAW = """
import numpy as np

from hil.config.values import Positive
from hil.control.law import LawSettings


class Spring:
    def __init__(self, stiffness, damping):
        self.stiffness, self.damping = stiffness, damping

    def reset(self):
        pass

    def effort(self, tick):
        tick["tau_law"] = self.stiffness * (tick["q_d"] - tick["q"]) + self.damping * (tick["dq_d"] - tick["dq"])


class SpringSettings(LawSettings):
    stiffness_N_m: Positive
    damping_N_s_m: Positive

    def build(self, context):
        return Spring(self.stiffness_N_m, self.damping_N_s_m)
"""
SECTION = """controller:
  law: ./laws/spring.py:SpringSettings
  stiffness_N_m: 2.0e6
  damping_N_s_m: 8.0e4
"""


@pytest.fixture
def file(tmp_path):
    """A configuration with a law in a file below its folder."""
    (tmp_path / "laws").mkdir()
    (tmp_path / "laws/spring.py").write_text(LAW)
    text = (Path(__file__).parents[3] / "configs/virtual.yaml").read_text()
    path = tmp_path / "mine.yaml"
    path.write_text(re.sub(r"^controller:\n(?: .*\n|\n)*", SECTION, text, flags=re.MULTILINE))
    return path


def replay(log, *options):
    return CliRunner().invoke(main, ["replay", str(log), *options])


def test_law_from_a_python_file_replays_only_with_the_unchanged_file(file, monkeypatch):
    log = file.with_name("a.mcap")
    assert hil.sim(file, duration_s=0.2, log=log).summary["replay"]["exact"]
    monkeypatch.chdir("/")
    assert replay(log).exit_code == 0
    assert recorded_run(log).configuration.controller.model_dump()["stiffness_N_m"] == 2e6
    law = file.with_name("laws") / "spring.py"
    law.write_text("raise SystemExit('another file')")
    with pytest.raises(LogError, match="its law is code"):
        recorded_run(log)
    refused = replay(log)
    assert refused.exit_code == 2
    assert "--trust-code" in refused.output
    assert replay(log, "--trust-code").exit_code == 0
    law.unlink()
    assert replay(log).exit_code == 2
    assert replay(log, "--trust-code", "--set", "controller.stiffness_N_m=1e6").exit_code == 0
    assert (
        CliRunner().invoke(main, ["report", str(log), "--out", str(log.with_suffix(".html"))]).exit_code == 0
    )
    assert isinstance(open_run(log)[2].controller, UnreadLaw)


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        (
            "stiffness_N_m: 2.0e6",
            "stiffnes_N_m: 2.0e6",
            "controller.stiffnes_N_m",
            "did you mean stiffness_N_m",
        ),
        ("stiffness_N_m: 2.0e6", "stiffness_N_m: -1", "controller.stiffness_N_m", "greater than 0"),
        ("laws/spring", "laws/gone", "controller.law", "No such file"),
        (":SpringSettings", ":Other", "controller.law", "no class Other"),
        (":SpringSettings", ":Spring", "controller.law", "LawSettings"),
    ],
)
def test_invalid_controller_section_with_a_law_file_is_refused_with_its_line(file, old, new, place, words):
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(ConfigurationError, match=rf"mine\.yaml:\d+:\d+: {place}: .*{words}"):
        load(file)


@pytest.mark.parametrize(
    ("code", "words"), [("x = 1\n1 / 0\n", r"spring\.py:2: ZeroDiv"), ("def", "SyntaxError")]
)
def test_law_file_with_an_error_is_refused_with_its_line(file, code, words):
    (file.with_name("laws") / "spring.py").write_text(code)
    with pytest.raises(ConfigurationError, match=words):
        load(file)


def test_configuration_with_a_law_file_can_be_pickled_to_another_process(file):
    code = "import pickle, sys; c = pickle.load(sys.stdin.buffer); print(c.controller, c.law_file.path.name)"
    here = pickle.dumps(load(file))
    done = subprocess.run([sys.executable, "-c", code], input=here, capture_output=True, check=True)
    assert b"stiffness_N_m=2000000.0" in done.stdout
    assert b"spring.py" in done.stdout


def test_replay_does_not_run_a_law_file_that_this_user_never_loaded(file, tmp_path, monkeypatch):
    log = file.with_name("a.mcap")
    hil.sim(file, duration_s=0.1, log=log)
    monkeypatch.setattr("hil.app.configuration.law_file._KNOWN", tmp_path / "another user")
    assert replay(log).exit_code == 2
    load(file)
    assert replay(log).exit_code == 0


def test_log_of_a_law_with_a_certificate_is_read(file):
    text = file.read_text()
    loads(re.sub(r"^(monitor:.*\n  action: )\w+", r"\1warn", text, flags=re.MULTILINE), "a.mcap")
