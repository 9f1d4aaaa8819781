"""What is refused of an FMU of one's own before anything runs: no host for it, faults without an input."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.fault_words import with_faults
from hil.cli import main
from hil.study.compare.command import compare, with_options
from hil.study.faults.cases import MATRIX, cases
from plant_fmu.faults import FAULTS
from tests.hil.app.test_check_fmu import OURS, configured

WRENCH = "wrench_step force=0,0,-10"
SLIPS = ["brake_stuck_open leg=1", "brake_stuck_closed leg=1", "brake_slipping leg=1 share=0.5"]
NAMES = {"brake": "b", "wrench": "w"}


def own(*inputs: str, faults: str = "") -> Configuration:
    """Return a configuration whose FMU has such inputs beside the forces."""
    mapped = "".join(f"    {name}: [{NAMES[name]}]\n" for name in inputs)
    text = load("virtual").text.partition("\nplant:")[0] + OURS.format(path="own.fmu", brake="")
    text = text.replace("    brake: []\n", mapped) + faults
    return loads(text, "my.yaml")


@pytest.mark.parametrize(
    ("words", "inputs", "why"),
    [
        (WRENCH, ("brake",), "map six in plant.model.wrench"),
        ("payload_step mass=5", ("brake",), "no FMU of one's own tells"),
        ("payload_step mass=5", ("brake", "wrench"), "no FMU of one's own tells"),
        *((words, ("wrench",), "map six inputs in plant.model.brake") for words in SLIPS),
    ],
)
def test_a_fault_that_would_come_to_nothing_at_an_fmu_is_refused(
    words: str, inputs: tuple[str, ...], why: str
) -> None:
    kind = words.partition(" ")[0]
    with pytest.raises(ConfigurationError, match=f"{kind} needs .*{why}"):
        with_faults(own(*inputs), [words])


def test_such_a_fault_of_the_configuration_is_refused_at_its_place() -> None:
    with pytest.raises(ConfigurationError, match=r"plant\.faults\[1\]\.kind: wrench_step needs inputs"):
        own(faults="  faults: [{kind: drive_silence, leg: 1}, {kind: wrench_step, force_N: [0, 0, 1]}]\n")


def test_a_fault_with_an_input_is_taken() -> None:
    taken = with_faults(own("brake", "wrench"), [WRENCH, *SLIPS, "brake_slow leg=1 by=5"])
    assert taken.plant is not None
    assert len(taken.plant.faults) == 5
    with_faults(own(), ["brake_slow leg=1 by=5"])  # the drive keeps its force for longer


@pytest.mark.parametrize(
    ("inputs", "without"),
    [
        (("brake", "wrench"), {"payload_step"}),
        (("brake",), {"payload_step", "wrench_step"}),
        (("wrench",), {"payload_step", "brake_stuck_open", "brake_stuck_closed", "brake_slipping"}),
    ],
)
def test_the_matrix_has_no_fault_that_would_pass_because_nothing_happens(
    inputs: tuple[str, ...], without: set[str]
) -> None:
    found = {case.name for case in cases(own(*inputs))}
    kinds = {kind for kind in FAULTS if not kind.startswith("process")} - without
    assert found == {f"{kind}/{moment}" for kind in kinds for moment in MATRIX}


@pytest.mark.parametrize(
    ("plant", "why"), [("own", "map six in plant.model.wrench"), ("bench", "plant type bench has none")]
)
def test_laws_are_not_compared_under_a_load_that_nothing_carries(plant: str, why: str) -> None:
    c = own("brake") if plant == "own" else load(plant)
    loaded = with_options(c, wrench=(0.0, 0.0, -50.0, 0.0, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match=rf"compare\.disturbance \(--wrench\): wrench_step .*{why}"):
        compare(loaded, laws=["pd"], path_laws=(), duration_s=0.01, jobs=1)


@pytest.mark.parametrize(
    "command",
    [
        ("faults", "--only", "plant_crash", "--jobs", "1"),
        ("compare", "--laws", "pd", "--duration", "0.01", "--jobs", "1", "--picture", "a.png"),
    ],
    ids=lambda command: command[0],
)
def test_an_fmu_that_cannot_be_hosted_is_refused_once_and_not_run_by_run(
    command: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = configured(tmp_path, "brake")
    file.write_text(file.read_text().replace("rate: [rate]", "rate: [speed]\n    isolation: in_process"))
    monkeypatch.chdir(tmp_path)
    name, *options = command
    result = CliRunner().invoke(main, [name, str(file), *options])
    assert result.exit_code == 2, result.output
    assert "no variable 'speed'" in result.output
    assert "could not be run" not in result.output
