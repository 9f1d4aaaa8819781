"""Cost of an extension: each row of the table "How to add" in the architecture guide, applied to a copy and run."""

import json
import re
import shutil
import subprocess
import sys
from os import environ
from pathlib import Path

import numpy as np
import pytest

from hil.record.log import Log

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
PARTS = Path(__file__).parent / "parts"
LIMITS = {"column": 2, "safety rule": 3, "plant fault": 2, "command": 2}
"""Largest number of source files touched by an extension; a law or a protocol is a separate package."""
NEW = None
"""In place of an anchor: the file is new."""


STEPS: dict[str, list[tuple[str, str | None, str]]] = {
    "column": [
        (
            "drivers/tick_columns.py",
            '    _("effort", "probe_force"',
            '    _("reference", "leg_error", float, "m", "q_d less q", *PER_LEG),\n',
        ),
        (
            "hil/loop/compiled_pass.py",
            "    tick.reference_time_s = time_at(override, tick.tick)\n",
            "    tick.leg_error[:] = tick.q_d - tick.q\n",
        ),
    ],
    "safety rule": [
        ("drivers/signals.py", "\n\nclass Doubt(IntEnum)", "    CEILING = 1048576\n"),
        ("hil/safety/ceiling.py", NEW, (PARTS / "rule.py").read_text()),
        (
            "hil/safety/kernels.py",
            "from hil.safety.encoder_rules",
            "from hil.safety.ceiling import too_high\n",
        ),
        (
            "hil/safety/kernels.py",
            "    if not tick.hop < HOP:\n",
            "    if too_high(tick.p[2]):\n        faults |= Fault.CEILING.value\n",
        ),
    ],
    "plant fault": [
        ("plant_fmu/faults/derated.py", NEW, (PARTS / "fault.py").read_text()),
        (
            "plant_fmu/faults/__init__.py",
            "from plant_fmu.faults.fault import",
            "from plant_fmu.faults import derated as derated\n",
        ),
    ],
    "command": [
        ("hil/cli/lengths.py", NEW, (PARTS / "command.py").read_text()),
        ("hil/cli/__init__.py", '    "run": "', '    "lengths": "Leg lengths at home.",\n'),
    ],
}


def sources(tree):
    files = (path for package in ("drivers", "hil", "plant_fmu") for path in (tree / package).rglob("*"))
    return {
        path.relative_to(tree).as_posix(): path.read_bytes()
        for path in files
        if path.is_file() and path.suffix != ".pyc"
    }


def insert(file, anchor, text):
    """Insert a text before the only occurrence of the anchor."""
    if anchor is NEW:
        assert not file.exists()
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        return
    before = file.read_text()
    assert before.count(anchor) == 1, f"{file}: {anchor!r} occurs {before.count(anchor)} times"
    file.write_text(before.replace(anchor, text + anchor))


@pytest.fixture(scope="session")
def copied(tmp_path_factory):
    """A copy of the tree with every extension, and the source files changed by each."""
    tree = tmp_path_factory.mktemp("tree")
    listed = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    for name in subprocess.run(listed, cwd=ROOT, capture_output=True, check=True).stdout.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, tree / name)
    touched = {}
    before = sources(tree)
    for extension, steps in STEPS.items():
        for path, anchor, text in steps:
            insert(tree / path, anchor, text)
        after = sources(tree)
        touched[extension] = {path for path in after if before.get(path) != after[path]}
        before = after
    return tree, touched


@pytest.fixture(scope="session")
def tree(copied):
    return copied[0]


def python(tree, *arguments, code=0):
    """Run the copy with this interpreter; return its output."""
    here = environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=tree,
        env=here,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def ask(tree, script):
    return json.loads(python(tree, "-c", (PARTS / script).read_text()).splitlines()[-1])


def changed(tree, name, *changes):
    """Write a shipped configuration with changed lines, and return its name."""
    text = (tree / f"configs/{name}.yaml").read_text()
    for pattern, new in changes:
        text, found = re.subn(pattern, new, text, flags=re.MULTILINE | re.DOTALL)
        assert found == 1, pattern
    (tree / "changed.yaml").write_text(text)
    return "changed.yaml"


@pytest.mark.parametrize("extension", LIMITS)
def test_extension_of_each_documented_kind_touches_at_most_the_allowed_number_of_files(copied, extension):
    assert 1 <= len(copied[1][extension]) <= LIMITS[extension], copied[1][extension]


@pytest.mark.parametrize("extension", LIMITS)
def test_architecture_guide_lists_the_files_touched_by_each_kind_of_extension(copied, extension):
    """Existing files by their path, new ones by their folder."""
    page = (ROOT / "docs/guides/architecture.md").read_text()
    row = re.search(rf"^\| a {extension} \|.*$", page, re.MULTILINE)
    assert row is not None
    for path in copied[1][extension]:
        named = path if (ROOT / path).exists() else f"{Path(path).parent}/"
        assert f"`{named}" in row[0], named


def test_new_log_column_of_an_extension_is_in_the_log_with_its_unit(tree):
    python(tree, "-m", "hil.cli", "sim", "virtual", "--duration", "0.05", "--log", "column.mcap")
    log = Log.open(tree / "column.mcap")
    column = next(column for column in log.columns if column.name == "leg_error")
    assert (column.unit, column.meaning, column.elements[5]) == ("m", "q_d less q", "leg_5")
    rows = log.rows()
    np.testing.assert_array_equal(rows["leg_error"], rows["q_d"] - rows["q"])
    assert rows["leg_error"].any()


def test_new_safety_rule_of_an_extension_faults_the_run(tree):
    """The ceiling of the rule is 1.15 m; the shipped path stays below."""
    hold = "reference: {type: hold, duration_s: 1, pose: {position_m: [0, 0, 1.2]}}\n\n"
    high = changed(tree, "virtual", ("^reference:.*?(?=^limits:)", hold))
    said = python(tree, "-m", "hil.cli", "sim", high, "--log", "rule.mcap", code=1)
    assert "CEILING" in said
    rows = Log.open(tree / "rule.mcap").rows()
    first = rows["faults"].tolist().index(1048576)
    assert rows["p"][first, 2] > 1.15 > rows["p"][first - 1, 2]


def test_new_kind_of_injected_fault_of_an_extension_acts_on_its_leg(tree):
    """Leg 5 applies half of its commanded force, the others all of it."""
    assert ask(tree, "ask_fault.py") == [1.0, 1.0, 1.0, 1.0, 1.0, 0.5]


def test_new_command_of_an_extension_runs_and_is_listed_in_the_help(tree):
    assert re.search(
        r"^  lengths +Leg lengths at home\.$", python(tree, "-m", "hil.cli", "--help"), re.MULTILINE
    )
    # the book's home: base hexagon of 2 m, platform triangle of 1 m, 1 m above it
    length = np.sqrt((2 - np.sqrt(0.75)) ** 2 + 0.25 + 1)
    assert python(tree, "-m", "hil.cli", "lengths").split() == [f"{length:.3f}"] * 6
