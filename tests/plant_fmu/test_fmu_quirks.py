"""FMUs with the quirks of exporters: failing resets, steps of their own, Boolean brakes, odd archives, warnings."""

from __future__ import annotations

import contextlib
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.errors import PlantError
from plant_fmu.fmu.check import FmuSpec, read_interface
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.propose import propose
from tests.legs_fmu import MAPPED, MASS_KG, START_M, legs_fmu
from tests.plant_fmu.test_fmu_child import altered

FORCE, OPEN, CALM = 100.0 * (1.0 + np.arange(6.0)), np.zeros(6), np.zeros(6)
DT = 1e-3


def spec(path: Path, **changes: Any) -> FmuSpec:
    return FmuSpec(path=str(path), **{**MAPPED, **changes})


def pushed(host: FmuHost | ChildHost, steps: int = 5) -> Array:
    """Rates after some steps of constant force: t F / m, from rest."""
    for _ in range(steps):
        _, rate = host.step(FORCE, OPEN, CALM, DT)
    return rate


@pytest.mark.parametrize(
    ("kind", "quirks", "word"),
    [
        (FmuHost, ["NO_RESET"], "fmi2Reset"),
        (FmuHost, ["INIT_ONCE"], "fmi2EnterInitializationMode"),
        (FmuHost, ["RESET_KEEPS"], "other lengths or rates"),
        (ChildHost, ["NO_RESET"], "fmi2Reset"),
        pytest.param(ChildHost, ["NO_RESET", "ONCE"], "Failed to instantiate", marks=pytest.mark.long),
        pytest.param(ChildHost, ["CRASHING_RESET"], "SIGABRT", marks=pytest.mark.long),
    ],
)
def test_fmu_that_cannot_be_reset_is_instantiated_again(tmp_path, kind, quirks, word):
    with contextlib.closing(kind(spec(legs_fmu(tmp_path / "a.fmu", *quirks)))) as host:
        host.reset()
        assert host.notes() == [], "nothing moved: no reset is needed"
        for _ in range(2):
            np.testing.assert_allclose(pushed(host), 5 * DT * FORCE / MASS_KG, rtol=1e-12)
            length, rate = host.reset()
            np.testing.assert_array_equal(np.concatenate([length, rate]), [START_M] * 6 + [0.0] * 6)
        (note,) = host.notes()
        assert "cannot be reset" in note
        assert word in note


def test_failed_reset_of_an_fmu_that_cannot_be_loaded_again_prevents_further_steps(tmp_path):
    host = FmuHost(spec(legs_fmu(tmp_path / "a.fmu", "NO_RESET")))
    pushed(host)
    (tmp_path / "a.fmu").unlink()
    for file in Path(host._folder.name).rglob("*.so"):
        file.unlink()
    with pytest.raises(PlantError, match="cannot be loaded"):
        host.reset()
    with pytest.raises(PlantError, match="failed to initialise"):
        pushed(host)
    host.close()


@pytest.mark.parametrize("brake", ["Real", "Boolean", "Integer"])
def test_fmu_brake_variables_of_type_real_boolean_or_integer_hold_their_legs(tmp_path, brake):
    path = legs_fmu(tmp_path / "a.fmu", brake=brake)
    assert propose(path).mapped["brake"] == tuple(f"brake[{k}]" for k in range(1, 7))
    engaged = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    with contextlib.closing(FmuHost(spec(path))) as host:
        _, rate = host.step(FORCE, engaged, CALM, DT)
        np.testing.assert_allclose(rate, (1.0 - engaged) * DT * FORCE / MASS_KG, rtol=1e-12)
        _, rate = host.step(FORCE, OPEN, CALM, DT)
        np.testing.assert_allclose(rate, (2.0 - engaged) * DT * FORCE / MASS_KG, rtol=1e-12)


def test_fmu_brake_variables_of_several_types_are_refused(tmp_path):
    path = legs_fmu(tmp_path / "a.fmu", brake=["Boolean"] * 5 + ["Real"])
    with pytest.raises(PlantError, match=r"'brake\[6\]' is of type Real.*of one type"):
        FmuHost(spec(path))


@pytest.mark.parametrize(
    ("name", "word"), [("./{}", ""), ("././{}", ""), ("\\", r"refused: .*unpack the FMU and pack it again")]
)
def test_fmu_archive_names_that_begin_with_a_dot_are_read_and_backslashes_are_refused(tmp_path, name, word):
    path = legs_fmu(tmp_path / "a.fmu", name=name)
    if word:
        with pytest.raises(PlantError, match=word):
            propose(path)
        return
    assert propose(path).obstacle == ""
    with contextlib.closing(FmuHost(spec(path))) as host:
        np.testing.assert_allclose(pushed(host), 5 * DT * FORCE / MASS_KG, rtol=1e-12)


@pytest.mark.parametrize("kind", [FmuHost, ChildHost])
def test_configured_offset_is_added_to_the_leg_lengths_of_an_fmu(tmp_path, kind):
    path = legs_fmu(tmp_path / "a.fmu", "STROKE")
    for offset in (START_M, [START_M + 0.01 * leg for leg in range(6)]):
        with contextlib.closing(kind(spec(path, length_offset_m=offset))) as host:
            np.testing.assert_allclose(host.reset()[0], offset, rtol=0, atol=1e-15)
            length, rate = host.step(FORCE, OPEN, CALM, DT)
            np.testing.assert_allclose(length - offset, rate * DT, rtol=0, atol=1e-15)


@pytest.mark.parametrize("kind", [FmuHost, ChildHost])
def test_warnings_of_an_fmu_are_counted_with_the_first_message(tmp_path, kind):
    with contextlib.closing(kind(spec(legs_fmu(tmp_path / "a.fmu", "WARNS")))) as host:
        pushed(host, 7)
        (note,) = host.notes()
        assert "7, the first message: tolerance 1e-06 not met at 0 s" in note


STEPS = {
    "longer": ('stepSize="0.002"', "", 1000.0, "step_us: 2000 with a loop.rate_Hz of at most 500"),
    "no divisor": ('stepSize="0.0004"', "", 1000.0, "step_us: 1200"),
    "equal": ('stepSize="0.001"', "", 1000.0, ""),
    "divisor": ('stepSize="1e-4"', "", 1000.0, ""),
    "variable": ('stepSize="0.002"', 'canHandleVariableCommunicationStepSize="true"', 1000.0, ""),
    "unstated": ('stopTime="1"', "", 1000.0, ""),
    "invalid": ('stepSize="fast"', "", 1000.0, ""),
}


@pytest.mark.parametrize(("experiment", "cs", "step_us", "word"), STEPS.values(), ids=STEPS)
def test_step_that_differs_from_the_fixed_step_of_the_fmu_is_refused(tmp_path, experiment, cs, step_us, word):
    path = legs_fmu(tmp_path / "a.fmu", experiment=experiment, cs=cs)
    found = read_interface(spec(path)).unfit_step(step_us * 1e-6)
    assert (word in found) if word else not found


SWITCH = """
NO_VARIABLES(Get%s)
API FMI(fmi3Set%s)(Instance *instance, const Ref *refs, size_t n, const %s *values, size_t n_values)
{
    double reals[6];
    for (size_t i = 0; i < n_values; i++) reals[i] = values[i];
    return fmi3SetFloat64(instance, refs, n, reals, n_values);
}
"""


@pytest.mark.parametrize(("kind", "c_type"), [("UInt8", "uint8_t"), ("Int16", "int16_t")])
def test_fmi_3_brake_variables_of_integer_type_hold_their_legs(tmp_path, kind, c_type):
    path = altered(tmp_path, SWITCH % (kind, kind, c_type), f"WITHOUT({kind})")
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    typed = re.subn(
        rb'<Float64( name="brake".*?)</Float64>', rb"<%b\1</%b>" % (kind.encode(), kind.encode()),
        members["modelDescription.xml"], flags=re.DOTALL,
    )  # fmt: skip
    assert typed[1] == 1
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (members | {"modelDescription.xml": typed[0]}).items():
            archive.writestr(name, data)
    names: dict[str, Any] = {key: [key] for key in ("force", "length", "rate", "brake")}
    engaged = np.array([1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    with contextlib.closing(FmuHost(FmuSpec(path=str(path), **names))) as host:
        _, rate = host.step(OPEN, engaged, CALM, DT)
    assert ((np.abs(rate) < 1e-9) == engaged.astype(bool)).all()
