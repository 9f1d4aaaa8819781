"""Commands that read a file refuse a bad one with exit code 2 and its name, and write nothing."""

from __future__ import annotations

import hashlib
import os
import re
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli import main
from plant_fmu.stewart.build import build
from tests.hil.app.texts import VIRTUAL, edited

FIRST_TIME = re.compile(r"^compiling the mathematics, once: .*\n", re.MULTILINE)


def contents(folder):
    """Every file below a folder, with a digest of its content."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in folder.rglob("*")
        if p.is_file()
    }


@pytest.fixture
def refused(tmp_path, monkeypatch):
    """Run a command in an empty folder; it must refuse, and neither change nor create a file."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        before = contents(tmp_path)
        result = CliRunner().invoke(main, [str(w) for w in words])
        assert isinstance(result.exception, SystemExit), result.exception
        assert result.exit_code == 2, result.output
        assert result.stdout == ""
        assert "Traceback" not in result.stderr
        assert contents(tmp_path) == before
        return FIRST_TIME.sub("", result.stderr)

    return run


@pytest.fixture
def bench(tmp_path):
    """Write the default configuration with changes; return its path."""

    def write(*changes):
        path = tmp_path / "bench.yaml"
        path.write_text(edited(*changes))
        return path

    return write


# -- any file ------------------------------------------------------------------------------------------------

CONFIGURATION = [
    "sim X", "run X --arm", "plant X", "check X", "stability X", "workspace X", "compare X", "faults X",
    "bringup X --rehearse --yes", "watch X", "homing X", "ctl X status", "setpoint X --position 0 0 1",
    "identify X", "campaign X", "design hinf X", "learn X --runs 2 -o n.csv", "calibrate X poses.csv",
    "adapter X", "doctor X",
]  # fmt: skip
LOG = [
    "replay X", "report X", "plot X", "export X a.csv", "view X", "identify payload X", "identify sensors X",
    "learn X -o n.csv",
]  # fmt: skip
OTHER = [("bad.csv", "sim virtual --commands X"), ("bad.csv", "calibrate lab X"), ("bad.yaml", "schema X")]
BAD = {
    "missing": None,
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "no text": bytes(range(128, 256)),
    "nothing": b"",
    "half a list": b"bus: [1, 2\n",
    "a list": b"- 1\n- 2\n",
}


def cases():
    lines = [("bad.yaml", line, BAD) for line in CONFIGURATION] + [("bad.mcap", line, BAD) for line in LOG]
    return [
        pytest.param(line.replace("X", name), name, bad, id=f"{line}, {bad}")
        for name, line, kinds in [*lines, *((*each, list(BAD)[:4]) for each in OTHER)]
        for bad in kinds
    ]


@pytest.mark.parametrize(("line", "name", "bad"), cases())
def test_commands_refuse_a_missing_or_invalid_input_file_with_its_name(refused, tmp_path, line, name, bad):
    content = BAD[bad]
    if callable(content):
        content(tmp_path / name)
    elif content is not None:
        (tmp_path / name).write_bytes(content)
    assert name in refused(*line.split())


# -- configuration -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["sim", "run", "plant", "check"])
def test_invalid_value_is_reported_in_one_line_with_its_place(refused, bench, command):
    said = refused(command, bench(("wn_rad_s: 20\n", "wn_rad_s: .nan\n")))
    line = VIRTUAL[: VIRTUAL.index("wn_rad_s: 20\n")].count("\n") + 1
    assert re.match(rf"hil: \S*bench\.yaml:{line}:\d+: controller.wn_rad_s: not a finite number", said)
    assert said.count("\n") == 1


@pytest.mark.parametrize("command", ["sim", "run", "plant", "check"])
def test_reference_beyond_a_limit_is_refused_before_the_start(refused, bench, command):
    said = refused(command, bench(("speed_m_s: 2 ", "speed_m_s: 1 ")))
    assert re.search(r"reference: at t = 0\.(\d+) s: leg \d: rate above limits\.speed_m_s 1", said), said


# -- FMU -----------------------------------------------------------------------------------------------------

MODEL = VIRTUAL[VIRTUAL.index("    type: stewart") : VIRTUAL.index("  drives:\n    encoder")]
FOREIGN = """\
    type: fmu
    path: robot.fmu
    isolation: in_process
    force: [force]
    length: [length]
    rate: [rate]
    brake: [brake]
    step_us: 1000
    parameters: {initial_position: [0, 0, 1]}
"""


@pytest.fixture
def robot(bench, tmp_path):
    """A bench with a copy of our FMU as a foreign plant, with changes to the mapping; some files left out."""

    def write(*changes, without=None):
        with zipfile.ZipFile(build("3.0")) as source, zipfile.ZipFile(tmp_path / "robot.fmu", "w") as target:
            for name in source.namelist():
                if without is None or not name.startswith(without):
                    target.writestr(name, source.read(name))
        return bench((MODEL, edited(*changes, base=FOREIGN)))

    return write


FMUS = {
    "no file": ([("robot.fmu", "other.fmu")], None, "plant.model.path: no such file"),
    "no binary": ([], "binaries/", "no binary for this machine"),
    "no such variable": ([("length: [length]", "length: [lenght]")], None, "no variable 'lenght'"),
    "another unit": ([("rate: [rate]", "rate: [length]"), ("length: [length]", "length: [rate]")], None, "m/s"),
    "no such parameter": ([("initial_position:", "initial_pose:")], None, "no variable 'initial_pose'"),
    # Book platform: q = sqrt(5 - 2 sqrt(3) + z^2), all legs; z = 1.1 in the plant and 1 in the configuration.
    "another start": ([("[0, 0, 1]", "[0, 0, 1.1]")], None, "plant:    1.6571 1.6571 1.6571"),
}  # fmt: skip


@pytest.mark.parametrize(("changes", "without", "words"), FMUS.values(), ids=FMUS)
def test_sim_refuses_an_fmu_that_does_not_fit_the_configuration(refused, robot, changes, without, words):
    assert words in refused("sim", robot(*changes, without=without))


def test_file_that_is_not_an_fmu_is_refused(refused, robot, tmp_path):
    config = robot()
    (tmp_path / "robot.fmu").write_bytes(b"PK but no more")
    assert "robot.fmu" in refused("sim", config)


def test_sim_accepts_a_plant_that_starts_1_mm_from_the_configured_pose(robot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = robot(("[0, 0, 1]", "[0, 0, 1.001]"))
    result = CliRunner().invoke(main, ["sim", str(config), "--duration", "0.2"])
    assert result.exit_code == 0, result.output
