"""Build of our FMU: choice of compiler, reproducible bytes, a token of the content, the cache, machines."""

import ctypes
import io
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from drivers.errors import PlantError
from plant_fmu.stewart import build as builder
from plant_fmu.stewart.build import Compiler, build
from tests.broad import broad

VERSIONS = ["2.0", "3.0"]
HEADERS = Path(fmpy.__file__).parent / "c-code"


@pytest.mark.parametrize(("version", "header"), [("2.0", "fmi2Functions.h"), ("3.0", "fmi3Functions.h")])
def test_fmu_binary_exports_exactly_the_functions_of_the_fmi_standard(version, header, tmp_path):
    text = (HEADERS / header).read_text()
    wanted = set(re.findall(r"#define (fmi[23]\w+)\s+fmi[23]FullName", text))
    assert len(wanted) > 30
    with zipfile.ZipFile(build(version)) as archive:
        name = next(n for n in archive.namelist() if n.startswith("binaries/"))
        (tmp_path / "library.so").write_bytes(archive.read(name))
    library = ctypes.CDLL(str(tmp_path / "library.so"))
    assert [n for n in sorted(wanted) if not hasattr(library, n)] == []
    assert not hasattr(library, "plant_step")


@pytest.mark.parametrize("version", broad(VERSIONS, quick=1))
def test_two_builds_of_the_fmu_from_the_same_sources_are_equal_in_every_byte(version, tmp_path, monkeypatch):
    first = build(version).read_bytes()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    again = build(version, tmp_path / "copy.fmu")
    assert again.read_bytes() == first
    assert [p.name for p in (tmp_path / "hexapod-hil" / "fmu").glob("*/*")] == [
        f"stewart_fmi{version[0]}.fmu"
    ]


def reference_of(archive):
    """Names of the inputs and their values; table of the reference results by column."""
    folder = "extra/org.fmi-standard.fmi-ls-ref/"
    stimuli, table = (
        np.genfromtxt(io.BytesIO(archive.read(folder + name)), delimiter=",", names=True, deletechars="")
        for name in ("stimuli.csv", "reference.csv")
    )
    return stimuli[0], table


def test_fmu_moves_as_its_reference_results_from_another_model(direct):
    """The FMU against DOP853 on the controller's model, which shares no line with the plant."""
    plant = direct()
    with zipfile.ZipFile(build("3.0")) as archive:
        stimuli, table = reference_of(archive)
    plant.start(**{n: [stimuli[f"{n}[{i + 1}]"] for i in range(6)] for n in ("force", "brake", "wrench")})
    for row in table:
        for name, size, limit in (("position", 3, 1e-9), ("length", 6, 1e-9), ("rate", 6, 1e-8)):
            want = [row[f"{name}[{i + 1}]"] for i in range(size)]
            assert np.abs(plant.get(name) - want).max() <= limit, (name, row["time"])
        plant.step(1e-3, 10)
    assert abs(table["rate[1]"][-1]) > 1.0


@pytest.mark.parametrize(("version", "icon"), [("2.0", "model.png"), ("3.0", "terminalsAndIcons/icon.png")])
def test_fmu_has_icon_documentation_licence_and_reference_results(version, icon):
    with zipfile.ZipFile(build(version)) as archive:
        assert archive.read(icon).startswith(b"\x89PNG")
        assert b"</html>" in archive.read("documentation/index.html")
        assert b"Apache-2.0" in archive.read("documentation/licenses/license.txt")
        stimuli, table = reference_of(archive)
    names = {v.name for v in fmpy.read_model_description(str(build("2.0"))).modelVariables}
    assert {*stimuli.dtype.names, *table.dtype.names} <= names
    assert validate_fmu(str(build(version))) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_fmu_instantiation_token_changes_with_each_source_and_the_description(monkeypatch, version):
    files = builder._source_files(version)
    assert {"model.c", "model.h", f"fmi{version[0]}.c"} < set(files)
    tokens = {builder.token("2.0"), builder.token("3.0"), builder.token(version)}
    for name, data in files.items():
        with monkeypatch.context() as changed:
            changed.setattr(
                builder, "_source_files", lambda *_, name=name, data=data: {**files, name: data + b"\n"}
            )
            tokens.add(builder.token(version))
    monkeypatch.setattr(builder, "model_description", lambda *_, **__: b"another")
    tokens.add(builder.token(version))
    assert len(tokens) == 3 + len(files)


def test_fmu_binary_refuses_the_instantiation_token_of_another_build(unpacked):
    folder, _ = unpacked
    fmu = FMU3Slave(guid="{other}", unzipDirectory=str(folder), modelIdentifier="stewart", instanceName="t")
    said = []
    with pytest.raises(Exception, match="instantiate"):
        fmu.instantiate(logMessage=lambda env, status, category, message: said.append(message))
    assert b"different builds" in said[0]


@pytest.mark.parametrize("bus", [None, {}], ids=["plant", "CAN FMU"])
def test_c_sources_of_the_fmu_compile_without_a_warning(bus, tmp_path):
    with zipfile.ZipFile(build("3.0", bus=bus)) as archive:
        archive.extractall(tmp_path)
    compiler = builder.find_compiler()
    sources = sorted(p.name for p in (tmp_path / "sources").glob("*.c"))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror", "-fPIC", "-shared"]
    done = subprocess.run(
        [*compiler.command, *flags, "-o", str(tmp_path / "x.so"), *sources, "-lm"],
        cwd=tmp_path / "sources",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_failed_compilation_of_the_fmu_reports_the_compiler_output_and_caches_nothing(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    files = builder._source_files("3.0")
    monkeypatch.setattr(builder, "_source_files", lambda *_: {**files, "plant.c": b"this is no C\n"})
    with pytest.raises(PlantError, match=r"(?s)exit code.*plant\.c"):
        build("3.0")
    assert list((tmp_path / "hexapod-hil" / "fmu").glob("*/*")) == []


@pytest.mark.parametrize("wanted", ['"gcc', "no-such-compiler", " ", "sh -c 'echo version 9; exit 1'"])
def test_compiler_in_environment_variable_cc_that_does_not_run_is_refused(monkeypatch, wanted):
    monkeypatch.setenv("CC", wanted)
    with pytest.raises(PlantError, match=r"CC=.*does not run"):
        builder.find_compiler()


OWN, CC, ZIG = ("tcc", "-m64"), ("/usr/bin/cc",), (sys.executable, "-m", "ziglang")


@pytest.mark.parametrize(
    ("wanted", "works", "zig", "expected"),
    [
        ("tcc -m64", {OWN, CC, ZIG}, False, OWN),
        ("", {OWN, CC, ZIG}, False, CC),
        ("", {OWN, ZIG}, False, (*ZIG, "cc")),
        ("tcc -m64", {OWN, CC, ZIG}, True, (*ZIG, "cc")),
        ("", set(), False, None),
    ],
)
def test_fmu_compiler_is_chosen_from_cc_then_the_system_then_zig(monkeypatch, wanted, works, zig, expected):
    monkeypatch.setenv("CC", wanted)
    monkeypatch.setattr(builder, "_identity", lambda command, _: "it" if command in works else None)
    monkeypatch.setattr("shutil.which", lambda _: CC[0])
    monkeypatch.setattr("importlib.util.find_spec", lambda _: True)
    if expected is None:
        with pytest.raises(PlantError, match="pip install ziglang"):
            builder.find_compiler(zig=zig)
        return
    assert builder.find_compiler(zig=zig).command == expected


MACHINES = {
    "linux-x86_64": ("linux64", "x86_64-linux", "stewart.so"),
    "linux-aarch64": ("aarch64-linux", "aarch64-linux", "stewart.so"),
    "windows-x86_64": ("win64", "x86_64-windows", "stewart.dll"),
    "darwin-x86_64": ("darwin64", "x86_64-darwin", "stewart.dylib"),
    "darwin-aarch64": ("aarch64-darwin", "aarch64-darwin", "stewart.dylib"),
}
"""Folders of the binary in FMI 2.0 and 3.0, and its file name."""


@pytest.mark.parametrize(("version", "at"), [("2.0", 0), ("3.0", 1)])
def test_release_fmu_has_each_binary_in_the_folder_of_its_fmi_version(monkeypatch, tmp_path, version, at):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(builder, "find_compiler", lambda **_: Compiler(("zig",), zig=True, identity=""))
    monkeypatch.setattr(builder, "_compile", lambda _, key, *__: key.encode())
    with zipfile.ZipFile(build(version, release=True)) as archive:
        found = {name: archive.read(name) for name in archive.namelist() if name.startswith("binaries/")}
    assert found == {f"binaries/{m[at]}/{m[2]}": key.encode() for key, m in MACHINES.items()}


def test_compiler_flags_targets_and_version_are_part_of_the_fmu_cache_key(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(builder, "_compile", lambda *_: b"binary")
    compiler = builder.find_compiler()
    places = [build("3.0"), build("2.0")]
    for name, other in (
        ("FLAGS", (*builder.FLAGS, "-O0")),
        ("find_compiler", lambda **_: compiler._replace(identity="another compiler")),
        ("TARGETS", {key: each._replace(folder="other") for key, each in builder.TARGETS.items()}),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(builder, name, other)
            places.append(build("3.0"))
    assert len(set(places)) == 5
    assert build("3.0") == places[0]
