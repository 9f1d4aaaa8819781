"""Where everything of an FMU stands for its calls, and what is made of it and removed."""

from __future__ import annotations

import ctypes as ct
import errno
import os
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from drivers.errors import PlantError
from plant_fmu.fmu import call as fmu_call
from plant_fmu.fmu import child
from plant_fmu.fmu import host as hosting
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.stewart.build import build

ADDRESSES = {
    "fmi2SetReal": 21,
    "fmi2GetReal": 22,
    "fmi2DoStep": 23,
    "fmi3SetFloat64": 31,
    "fmi3GetFloat64": 32,
    "fmi3DoStep": 33,
}
SPEC = FmuSpec(path="a.fmu", force=["f"], length=["q"], rate=["v"], truth=["p", "R", "twist", "applied"])
OUTPUTS = {
    "length": (50,),
    "rate": (60, 61, 62, 63, 64, 65),
    **{name: (70 + k,) for name, k in (("p", 3), ("R", 9), ("twist", 6), ("applied", 6))},
}


def prepared(monkeypatch: pytest.MonkeyPatch, major: int, *inputs: str) -> Any:
    host: Any = object.__new__(FmuHost)
    host.spec, host.internal_step_s, host._fmu = SPEC, SPEC.step_s, SimpleNamespace(component=77)
    host._record = np.zeros((), fmu_call.FMU)
    channels = {name: (10 * k + 1,) for k, name in enumerate(inputs)}
    host._interface = SimpleNamespace(major=major, inputs=channels, outputs=OUTPUTS)
    monkeypatch.setattr(hosting, "_address", lambda fmu, name: ADDRESSES[name] * (fmu is host._fmu))
    host._prepare_calls()
    host._record["ready"] = True
    return host


@pytest.mark.parametrize("major", [2, 3])
@pytest.mark.parametrize(
    ("inputs", "slots"),
    [
        (("force",), [0, -1, -1]),
        (("force", "wrench"), [0, -1, 6]),
        (("force", "brake", "wrench"), [0, 6, 12]),
    ],
)
def test_a_call_has_the_functions_of_its_standard_and_where_each_input_and_output_stands(
    monkeypatch, major, inputs, slots
):
    host = prepared(monkeypatch, major, *inputs)
    record = host._record
    functions = [int(record[name]) for name in ("instance", "counted", "set", "get", "step")]
    assert functions == [77, major == 3, *(10 * major + k for k in (1, 2, 3))]
    outputs = [reference for references in OUTPUTS.values() for reference in references]
    wanted = (("set", [10 * k + 1 for k in range(len(inputs))]), ("get", outputs))
    for name, references in wanted:
        assert record[f"{name}_count"] == len(references)
        at = int(record[f"{name}_references"])
        assert list((ct.c_uint32 * len(references)).from_address(at)) == references
    assert record["slots"].tolist() == slots
    assert (host._inputs.size, host._held.size, host._outputs.size) == (6 * len(inputs), 6 * len(inputs), 36)


def test_pose_twist_and_forces_follow_one_another_among_the_outputs(monkeypatch):
    host = prepared(monkeypatch, 3, "force")
    host._outputs[:] = np.arange(36.0)
    truth = host.truth()
    assert (truth.p.tolist(), truth.R.tolist()) == (
        [12, 13, 14],
        [[15, 16, 17], [18, 19, 20], [21, 22, 23]],
    )
    assert (truth.twist.tolist(), truth.applied_force.tolist()) == (
        list(range(24, 30)),
        list(range(30, 36)),
    )
    assert host.applied_force().tolist() == list(range(30, 36))
    host._outputs[:] = 0.0
    assert host.applied_force().tolist() == [0.0] * 6, "as it is now"
    kept = (truth.p, truth.R, truth.twist, truth.applied_force)
    assert [float(np.max(each)) for each in kept] == [14.0, 23.0, 29.0, 35.0], "the caller's to keep"
    host.spec = FmuSpec(path="a.fmu", force=["f"], length=["q"], rate=["v"])
    assert (host.truth(), host.applied_force()) == (None, None)


@pytest.mark.parametrize(("version", "kind"), [("2.0", FMU2Slave), ("3.0", FMU3Slave)])
def test_an_fmu_that_was_just_loaded_is_reset_before_its_second_use_alone(monkeypatch, version, kind):
    resets: list[object] = []
    reset = kind.reset

    def noted(fmu: object) -> None:
        resets.append(fmu)
        reset(fmu)

    monkeypatch.setattr(kind, "reset", noted)
    host = FmuHost(FmuSpec(path=str(build(version)), force=["force"], length=["length"], rate=["rate"]))
    assert resets == []
    host.reset()
    assert len(resets) == 1
    host.close()


def test_unpacked_files_that_cannot_be_removed_are_no_error(monkeypatch, tmp_path):
    def busy(*_given: object, **_named: object) -> None:
        tried.append(0)
        raise OSError(errno.EBUSY, "Device or resource busy")

    tried: list[int] = []
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(os, "rmdir", busy)
    spec = FmuSpec(path=str(build("3.0")), force=["force"], length=["length"], rate=["rate"])
    FmuHost(spec).close()

    def refuse(*_given: object, **_named: object) -> None:
        raise OSError("no more processes")

    monkeypatch.setattr(child, "start", refuse)
    with pytest.raises(PlantError, match="no child process for the FMU: no more processes"):
        child.ChildHost(spec)
    assert len(tried) >= 2


def test_an_fmu_that_was_loaded_and_not_initialised_is_freed_without_being_terminated(monkeypatch):
    calls: list[str] = []

    def noting(name: str) -> Callable[[object], None]:
        was = getattr(FMU3Slave, name)

        def noted(fmu: object) -> None:
            calls.append(name)
            was(fmu)

        return noted

    for name in ("terminate", "freeInstance"):
        monkeypatch.setattr(FMU3Slave, name, noting(name))

    def refuse(_host: FmuHost) -> None:
        raise PlantError("it is not prepared")

    monkeypatch.setattr(FmuHost, "_prepare_calls", refuse)
    with pytest.raises(PlantError, match="it is not prepared"):
        FmuHost(FmuSpec(path=str(build("3.0")), force=["force"], length=["length"], rate=["rate"]))
    assert calls == ["freeInstance"]
