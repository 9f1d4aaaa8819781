"""FMU of a user: the report of `hil check`, and faults that need an input of the FMU."""

from __future__ import annotations

import re

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, PlantError
from hil.app.check.command import inspect
from hil.app.check.leg_order import model_mobility
from hil.app.check.subject import looked_at
from hil.app.check.warnings import warnings
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.fault_words import with_faults
from hil.app.sim.command import simulate
from hil.cli import main
from hil.record.log import Log
from hil.study.faults.cases import MATRIX, cases
from plant_fmu.faults import FAULTS
from plant_fmu.fmu.probe import Probe
from plant_fmu.stewart.build import build
from tests.broad import broad
from tests.legs_fmu import MAPPED, legs_fmu

pytestmark = pytest.mark.usefixtures("unproven")
OURS = """
plant:
  model:
    type: fmu
    path: {path}
    force: [force]
    length: [length]
    rate: [rate]
    brake: [{brake}]
  drives: {{brake_open_ms: 50, brake_close_ms: 30}}
"""


def configured(folder, brake, path=None):
    text = load("virtual").text.partition("\nplant:")[0]
    file = folder / "own.yaml"
    file.write_text(text + OURS.format(path=path or build("3.0"), brake=brake))
    return file


def said(name, mobility):
    """Warnings about an FMU with this mobility as the plant of a shipped configuration."""
    subject = looked_at(load(name))
    subject.probe = Probe(np.zeros(6), mobility)
    return [text for code, text in warnings(subject) if code in {"plant.model coupling", "plant.model legs"}]


def test_check_of_an_fmu_with_uncoupled_legs_proposes_pd_for_the_largest_leg_mass():
    masses = np.array([40.0, 41.0, 50.0, 42.0, 43.0, 44.0])
    (text,) = said("virtual", np.diag(1 / masses))
    assert "controller.law: pd" in text
    assert "m = 50 kg" in text
    assert said("bench", np.diag(1 / masses)) == []


def test_check_accepts_an_fmu_with_coupled_legs_and_reports_a_leg_of_inverted_sign():
    platform = model_mobility(load("virtual"))
    assert said("virtual", platform) == []
    platform[:, 3] *= -1.0
    (text,) = said("virtual", platform)
    assert "shortens leg 3 of the FMU" in text


@pytest.mark.parametrize("brake", broad(["", "brake"], quick=1))
def test_check_and_sim_warn_about_a_plant_without_brakes(brake, tmp_path):
    file = configured(tmp_path, brake)
    codes = inspect(load(file)).codes
    assert ("plant.model.brake" in codes) == (not brake)
    printed = (
        CliRunner()
        .invoke(main, ["sim", str(file), "--duration", "0.05", "--log", str(tmp_path / "a.mcap")])
        .output
    )
    assert ("no brake holds this plant" in printed) == (not brake)
    assert printed.find("no brake holds") < printed.find("sim: ")


def test_check_prints_the_units_of_an_fmu_and_refuses_one_without_the_mapped_variable(tmp_path):
    report = inspect(load(configured(tmp_path, "brake")))
    assert "units of force, length and rate are stated" in report.sections["plant FMU"]
    assert report.figures["fmu"]["assumed_units"] == {}
    assert report.figures["fmu"]["uncoupled"] is False
    file = configured(tmp_path, "brake")
    file.write_text(file.read_text().replace("rate: [rate]", "rate: [speed]"))
    with pytest.raises(PlantError, match="no variable 'speed'"):
        inspect(load(file))


def legs(folder, *quirks, model="", **built):
    """Return a configuration of single legs whose plant is an FMU of them."""
    path = legs_fmu(folder / "legs.fmu", *quirks, **built)
    mapped = "".join(f"    {key}: {names}\n" for key, names in MAPPED.items())
    plant = f"plant:\n  model:\n    type: fmu\n    path: {path}\n    isolation: in_process\n{mapped}{model}"
    emulated = "  drives: {force_bandwidth_Hz: 200, brake_open_ms: 50, brake_close_ms: 30}\n"
    text = load("bench").text.partition("\nplant:")[0] + "\n" + plant + emulated
    limits = {"force_N": 2000, "force_step_N": 200, "force_window_N": 2000}
    changes = {"limits": limits, "monitor": {"friction_N": 5, "disturbance_m_s2": 2}}
    return loads(with_changes(text, changes), "legs.yaml", folder)


def offset(folder):
    """Return the key that the refusal of lengths that count from elsewhere proposes."""
    with pytest.raises(PlantError, match="leg lengths differ") as refused:
        inspect(legs(folder))
    (key,) = re.findall(r"plant\.model\.(length_offset_m: [0-9.]+)", str(refused.value))
    return f"    {key}\n"


def test_fmu_with_shifted_leg_lengths_is_refused_and_accepted_with_the_proposed_offset(tmp_path):
    report = inspect(legs(tmp_path, model=offset(tmp_path)))
    assert not [code for code in report.codes if code.startswith("plant.model")]
    assert report.figures["fmu"]["uncoupled"] is True


@pytest.mark.parametrize(
    ("quirks", "built", "code", "words"),
    [
        (["NO_RESET"], {}, "plant.model reports", ["cannot be reset"]),
        (["WARNS"], {"brake": "Boolean"}, "plant.model reports", ["7, the first message: tolerance 1e-06"]),
        (
            ["INNER=0.002"],
            {"experiment": 'stepSize="0.002"'},
            "plant.model.step_us",
            ["its own step is 0.002 s", "step_us: 2000", "500"],
        ),
        (["INNER=0.002"], {}, "plant.model legs", ["moves no leg", "step of the FMU"]),
    ],
)
def test_check_warns_about_each_unusual_property_of_an_fmu(quirks, built, code, words, tmp_path):
    report = inspect(legs(tmp_path, *quirks, model=offset(tmp_path), **built))
    (text,) = [text for each, text in zip(report.codes, report.warnings, strict=True) if each == code]
    for word in words:
        assert word in text


def test_warnings_of_an_fmu_are_counted_in_the_summary_and_in_the_log(tmp_path):
    c = legs(tmp_path, "WARNS", "NO_RESET", model=offset(tmp_path), brake="Boolean")
    summary = simulate(c, log=tmp_path / "a.mcap", duration_s=0.05, check_replay=False)
    (warning,) = summary["plant_warnings"]
    count = int(re.findall(r"warnings of the FMU: (\d+), the first message: tolerance 1e-06", warning)[0])
    assert abs(count - summary["ticks"]) <= 1
    assert [event.text for event in Log(tmp_path / "a.mcap").events() if event.level == "warning"] == [
        warning
    ]


WRENCH = "wrench_step force=0,0,-10"
SLIPS = ["brake_stuck_open leg=1", "brake_stuck_closed leg=1", "brake_slipping leg=1 share=0.5"]
NAMES = {"brake": "b", "wrench": "w"}


def own(*inputs: str, faults: str = "") -> Configuration:
    """A configuration with an FMU that has these inputs in addition to the forces."""
    mapped = "".join(f"    {name}: [{NAMES[name]}]\n" for name in inputs)
    text = load("virtual").text.partition("\nplant:")[0] + OURS.format(path="own.fmu", brake="")
    text = text.replace("    brake: []\n", mapped) + faults
    return loads(text, "my.yaml")


@pytest.mark.parametrize(
    ("words", "inputs", "why"),
    [
        (WRENCH, ("brake",), "map six in plant.model.wrench"),
        ("payload_step mass=5", ("brake",), "a custom FMU does not report"),
        ("payload_step mass=5", ("brake", "wrench"), "a custom FMU does not report"),
        *((words, ("wrench",), "map six in plant.model.brake") for words in SLIPS),
    ],
)
def test_fault_without_effect_on_an_fmu_is_refused(words: str, inputs: tuple[str, ...], why: str) -> None:
    kind = words.partition(" ")[0]
    with pytest.raises(ConfigurationError, match=f"{kind} needs .*{why}"):
        with_faults(own(*inputs), [words])


def test_fault_whose_fmu_input_is_mapped_is_accepted() -> None:
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
def test_fault_matrix_leaves_out_faults_without_effect(inputs: tuple[str, ...], without: set[str]) -> None:
    found = {case.name for case in cases(own(*inputs))}
    kinds = {kind for kind in FAULTS if not kind.startswith(("process", "sensor"))} - without
    assert found == {f"{kind}/{moment}" for kind in kinds for moment in MATRIX}
