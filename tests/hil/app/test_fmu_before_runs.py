"""What is refused of an FMU of one's own before anything runs: no host for it, faults without an input."""

from __future__ import annotations

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.fault_words import with_faults
from hil.study.faults.cases import MATRIX, cases
from plant_fmu.faults import FAULTS
from tests.hil.app.test_check_fmu import OURS

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
def test_a_fault_without_effect_at_an_fmu_is_refused(words: str, inputs: tuple[str, ...], why: str) -> None:
    kind = words.partition(" ")[0]
    with pytest.raises(ConfigurationError, match=f"{kind} needs .*{why}"):
        with_faults(own(*inputs), [words])


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
def test_the_fault_matrix_leaves_out_faults_without_effect(
    inputs: tuple[str, ...], without: set[str]
) -> None:
    found = {case.name for case in cases(own(*inputs))}
    kinds = {kind for kind in FAULTS if not kind.startswith("process")} - without
    assert found == {f"{kind}/{moment}" for kind in kinds for moment in MATRIX}
