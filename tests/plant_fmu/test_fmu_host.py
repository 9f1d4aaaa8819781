"""Hosting: agreement with fmpy's own simulation, and FMUs that are not what they should be."""

import ctypes as ct
import os
import re
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER, REAL
from drivers.compiled.pointed import of_python
from drivers.errors import PlantError
from plant_fmu.fmu import call as fmu_call
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.stewart.build import build

FORCE = np.array([3700.0, 3600.0, 3650.0, 3500.0, 3620.0, 3610.0])
VERSIONS = ["2.0", "3.0"]
XML = "modelDescription.xml"


def spec(path, **changes):
    names = {"force": ("force",), "length": ("length",), "rate": ("rate",), "brake": ("brake",)}
    return FmuSpec.model_construct(**{"path": str(path), **names, **changes})


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """The folder that FMUs are unpacked in."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_simulate_fmu_with_an_output_interval_agrees_to_1e_12(version):
    if version == "2.0":
        start = {f"force[{i + 1}]": FORCE[i] for i in range(6)} | {f"brake[{i + 1}]": 0.0 for i in range(6)}
        wanted = [f"length[{i}]" for i in range(1, 7)] + [f"rate[{i}]" for i in range(1, 7)]
    else:
        start = {"force": FORCE.tolist(), "brake": [0.0] * 6}
        wanted = ["length", "rate"]
    start["force_bandwidth"] = 200.0
    result = fmpy.simulate_fmu(
        str(build(version)), stop_time=0.3, output_interval=1e-3, start_values=start, output=wanted
    )
    rows = np.array([np.concatenate([np.ravel(x) for x in list(r)[1:]]) for r in result])
    host = FmuHost(spec(build(version), parameters={"force_bandwidth": 200.0}))
    ours = [np.concatenate(host.reset())]
    for _ in range(300):
        ours.append(np.concatenate(host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)))
    host.close()
    assert rows.shape == (301, 12)
    assert np.abs(rows - np.array(ours)).max() <= 1e-12
    assert np.abs(rows[-1] - rows[0]).max() > 1e-3


def test_closing_removes_the_unpacked_files_and_can_be_repeated(tmp_path, temporary):
    """They stay for as long as the FMU may read them."""
    host = FmuHost(spec(rewritten(build("3.0"), tmp_path / "reads.fmu", extra=[("resources/a", b"x")])))
    (folder,) = temporary.iterdir()
    assert (folder / XML).is_file()
    assert (folder / "resources/a").read_bytes() == b"x"
    host.close()
    host.close()
    assert not folder.exists()
    with pytest.raises(PlantError, match="closed"):
        host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)


@pytest.mark.parametrize("version", VERSIONS)
def test_our_fmu_has_no_file_left_while_it_runs_so_that_a_process_that_is_killed_leaves_none(
    version, temporary
):
    truth = "position", "rotation", "twist", "applied_force"
    host = FmuHost(spec(build(version), truth=truth))
    assert list(temporary.iterdir()) == []
    moved = [host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)[0] for _ in range(2)]
    host.reset()
    again = host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)[0]
    host.close()
    assert not np.array_equal(moved[0], moved[1])
    np.testing.assert_array_equal(again, moved[0])


def test_hosting_leaves_the_working_directory_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    FmuHost(spec(build("3.0"))).close()
    assert Path.cwd() == tmp_path


def test_parameters_reach_the_fmu_by_array_by_name_of_an_item_and_by_number():
    free = FmuHost(spec(build("2.0"), parameters={"mass": 1150}))
    q = free.step(FORCE, np.zeros(6), np.zeros(6), 0.02)[0]
    free.close()
    heavy = FmuHost(
        spec(build("2.0"), parameters={"mass": 2300, "leg_spin": "universal", "com": [0.0, 0.0, 0.1]})
    )
    assert (heavy.step(FORCE, np.zeros(6), np.zeros(6), 0.02)[0] < q - 1e-4).all()
    heavy.close()


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"weight": 1.0}, "no variable 'weight'"),
        ({"mass": "heavy"}, "no value of it"),
        ({"gravity": [0.0, 1.0]}, "3 elements but 2"),
        ({"length": [0.0] * 6}, "only parameters"),
        ({"leg_spin": "sometimes"}, "no value of it"),
        ({"leg_spin": 1.5}, "no value of it"),
        ({"leg_spin": float("inf")}, "no value of it"),
        ({"leg_spin": 10**310}, "no value of it"),
        ({"mass": 10**310}, "'mass' is of type .*; 10{59} is no value of it"),
        ({"com": [0.0, 10**310, 0.0]}, "no value of it"),
        ({"mass": -1.0}, "refused parameter 'mass'.*outside"),
        ({"length_max": [1.5] * 6}, "stroke"),
    ],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_a_parameter_that_cannot_be_is_refused(version, parameters, word):
    with pytest.raises(PlantError, match=word):
        FmuHost(spec(build(version), parameters=parameters))


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"force": ("thrust",)}, "no variable 'thrust'"),
        ({"force": ("forces",)}, "no variable 'forces'"),
        ({"force": ("length",)}, "causality output; input is needed"),
        ({"length": ("force",)}, "causality input; output is needed"),
        ({"length": ("rate",)}, "'rate.*' is in 'm/s'; m is needed"),
        ({"rate": ("length",)}, "'length.*' is in 'm'; m/s is needed"),
        ({"rate": ("applied_force",)}, "in 'N'; m/s is needed"),
        ({"force": ("brake",)}, "declares no unit"),
        ({"length": ("position",)}, "3 values; 6 are needed"),
        ({"brake": ("force", "wrench")}, "12 values; 6 are needed"),
    ],
)
@pytest.mark.parametrize("version", VERSIONS)
def test_a_variable_map_that_does_not_fit_is_refused(version, changes, word):
    with pytest.raises(PlantError, match=word):
        FmuHost(spec(build(version), **changes))


def test_one_variable_for_two_legs_is_refused():
    with pytest.raises(PlantError, match="mapped twice"):
        FmuHost(spec(build("2.0"), force=("force[1]",) * 6))


def rewritten(path, out, change=lambda name, data: data, extra=()):
    """Copy an FMU, changing or dropping (None) members and adding extra ones."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for member in source.infolist():
            data = change(member.filename, source.read(member))
            if data is not None:
                target.writestr(member.filename, data)
        for info, data in extra:
            target.writestr(info, data)
    return out


def edit(old, new):
    return lambda name, data: data.replace(old, new) if name == XML else data


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda n, d: None if n == XML else d, "modelDescription.xml cannot be read"),
        (lambda n, d: b"<fmiModel" if n == XML else d, "cannot be read"),
        (lambda n, d: b"" if n == XML else d, "cannot be read"),
        (edit(b'fmiVersion="3.0"', b'fmiVersion="3.1"'), "FMI 3.1; 2.0 and 3.0"),
        (edit(b'fmiVersion="3.0"', b'fmiVersion="2.1"'), "cannot be read: .*version: 2.1"),
        (edit(b"CoSimulation", b"ModelExchange"), "no co-simulation"),
        (lambda n, d: None if n.startswith("binaries/") else d, "no binary for this machine.*none"),
        (lambda n, d: b"no library" if n.startswith("binaries/") else d, "cannot be loaded"),
        (edit(b'unit="N"', b'unit="lbf"'), "in 'lbf'; N is needed"),
        (
            edit(b'<BaseUnit kg="1" m="1" s="-2" />', b'<BaseUnit kg="1" m="1" s="-2" factor="1000" />'),
            "in 'N'; N",
        ),
        (edit(b'instantiationToken="{', b'instantiationToken="{0'), "different builds"),
    ],
)
def test_an_fmu_that_is_not_what_it_should_be_is_refused(tmp_path, change, word):
    bad = rewritten(build("3.0"), tmp_path / "bad.fmu", change)
    with pytest.raises(PlantError, match=f"(?s)bad.fmu.*{word}"):
        FmuHost(spec(bad))


def test_a_binary_for_another_machine_is_named(tmp_path):
    with zipfile.ZipFile(build("3.0")) as source, zipfile.ZipFile(tmp_path / "bad.fmu", "w") as target:
        for name in source.namelist():
            moved = "binaries/x86_64-windows/stewart.dll" if name.startswith("binaries/") else name
            target.writestr(moved, source.read(name))
    with pytest.raises(PlantError, match=r"no binary for this machine.*x86_64-windows"):
        FmuHost(spec(tmp_path / "bad.fmu"))


def test_a_missing_file_and_a_file_that_is_no_archive_are_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.fmu")
    for other in (tmp_path, tmp_path / "pipe.fmu"):
        with pytest.raises(PlantError, match=f"{other.name}: no FMU: a folder, pipe, socket or device"):
            FmuHost(spec(other))
    with pytest.raises(PlantError, match="no such FMU"):
        FmuHost(spec(tmp_path / "none.fmu"))
    (tmp_path / "text.fmu").write_text("no archive")
    with pytest.raises(PlantError, match="not an FMU"):
        FmuHost(spec(tmp_path / "text.fmu"))


def test_a_zip_bomb_is_refused_and_writes_nothing(tmp_path, monkeypatch):
    bad = rewritten(build("3.0"), tmp_path / "bad.fmu", extra=[("resources/bomb", b"\0" * 8_000_000)])
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    with pytest.raises(PlantError, match="times its packed size"):
        FmuHost(spec(bad))
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_descriptions_of_one_name_are_refused(tmp_path):
    with zipfile.ZipFile(build("3.0")) as source:
        real = source.read(XML)
    first = rewritten(build("3.0"), tmp_path / "a.fmu", lambda n, d: b"<no/>" if n == XML else d)
    with pytest.raises(PlantError, match="occurs twice"):
        FmuHost(spec(rewritten(first, tmp_path / "b.fmu", extra=[(XML, real)])))


@pytest.mark.parametrize("reference", [-1, 2**32, 10**20])
def test_a_value_reference_that_is_none_is_refused(tmp_path, reference):
    def renumbered(name, data):
        pattern = rb'(name="force\[1\]" valueReference=)"\d+"'
        return re.sub(pattern, rb'\1"%d"' % reference, data) if name == XML else data

    bad = rewritten(build("2.0"), tmp_path / "bad.fmu", renumbered)
    with pytest.raises(
        PlantError, match=rf"'force\[1\]' has the valueReference '{reference}'; 0 to 4294967295"
    ):
        FmuHost(spec(bad))


def test_a_damaged_member_is_refused(tmp_path):
    data = bytearray(build("3.0").read_bytes())
    with zipfile.ZipFile(build("3.0")) as archive:
        member = next(m for m in archive.infolist() if m.filename.startswith("binaries/"))
    data[member.header_offset + 2000 : member.header_offset + 2100] = os.urandom(100)
    (tmp_path / "bad.fmu").write_bytes(data)
    with pytest.raises(PlantError, match=r"damaged|unpacked"):
        FmuHost(spec(tmp_path / "bad.fmu"))


def test_of_many_messages_the_last_are_told():
    host = FmuHost(spec(build("3.0")))
    for k in range(30):
        host._log(f"message {k}".encode())
    told = host._said()
    host.close()
    assert told == f": {'; '.join(f'message {k}' for k in range(10, 30))}"


@pytest.mark.parametrize(
    ("ended", "stepped"),
    [
        (fmu_call.INPUTS_REFUSED, False),
        (fmu_call.STEP_REFUSED, False),
        (fmu_call.OUTPUTS_REFUSED, True),
        (fmu_call.OUTPUT_NOT_FINITE, True),
    ],
)
def test_the_next_step_begins_where_the_fmu_is_after_a_step_that_failed(ended, stepped):
    host = FmuHost(spec(build("3.0")))
    begun_s: list[float] = []

    def step(_instance: int, t_s: float, _dt_s: float, *_places: int) -> int:
        begun_s.append(t_s)
        return 3 if ended == fmu_call.STEP_REFUSED and len(begun_s) == 1 else 0

    def refuse(_instance: int, _references: int, _count: int, values: int, _size: int) -> int:
        ct.c_double.from_address(values).value = np.nan
        return 0 if ended == fmu_call.OUTPUT_NOT_FINITE else 3

    stepping, refusing = (
        of_python(step, INTEGER, REAL, REAL, *[INTEGER] * 5),
        of_python(refuse, *[INTEGER] * 5),
    )
    host._record["step"] = stepping[0]
    at = "set" if ended == fmu_call.INPUTS_REFUSED else "get"
    before = int(host._record[at])
    if ended != fmu_call.STEP_REFUSED:
        host._record[at] = refusing[0]
    with pytest.raises(PlantError):
        host.step(FORCE, np.zeros(6), np.zeros(6), 2e-3)
    host._record[at] = before
    host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)
    host.close()
    assert begun_s[-1] == (2e-3 if stepped else 0.0)


@pytest.mark.parametrize("proxy", [True, False], ids=["filled in", "as they are"])
def test_an_fmu_of_fmi_2_is_given_memory_that_is_zero_and_its_messages_are_heard(monkeypatch, proxy, capsys):
    """The library that fills in what messages leave out is not on every machine."""
    if not proxy:
        monkeypatch.setitem(sys.modules, "fmpy.logging", None)
    host = FmuHost(spec(build("2.0")))
    callbacks = host._fmu.callbacks
    assert all((callbacks.allocateMemory, callbacks.freeMemory, callbacks.logger)), "none is a null pointer"
    memory = callbacks.allocateMemory(3, 8)
    assert memory
    assert bytes((ct.c_char * 24).from_address(memory)) == bytes(24)
    callbacks.freeMemory(memory)
    callbacks.logger(None, b"plant", 3, b"category", b"it fails")
    assert host._messages == ["it fails"]
    host.close()
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("version", VERSIONS)
def test_after_a_reset_that_the_fmu_refuses_it_takes_no_step(monkeypatch, version):
    def refuse() -> None:
        raise RuntimeError("reset fails")

    host = FmuHost(spec(build(version)))
    monkeypatch.setattr(host._fmu, "reset", refuse)
    with pytest.raises(PlantError, match="cannot be initialised: reset fails"):
        host.reset()
    with pytest.raises(PlantError, match="failed to initialise; reset it"):
        host.step(FORCE, np.zeros(6), np.zeros(6), 1e-3)
    host.close()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("brake", [("brake",), ()], ids=["brake", "none"])
def test_a_reset_leaves_no_force_no_wrench_and_engaged_brakes(version, brake):
    host = FmuHost(spec(build(version), brake=brake, wrench=("wrench",)))
    host.step(FORCE, np.zeros(6), np.full(6, 3.0), 1e-3)
    host.reset()
    get = host._fmu.getReal if version == "2.0" else host._fmu.getFloat64
    held = {key: get(list(references), *([6] if version == "3.0" else []))
            for key, references in host._interface.inputs.items()}  # fmt: skip
    host.close()
    assert held == {"force": [0.0] * 6, **({"brake": [1.0] * 6} if brake else {}), "wrench": [0.0] * 6}
