"""The FMU as an artefact: valid, complete, reproducible."""

import ctypes
import errno
import re
import subprocess
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu
from lxml import etree  # type: ignore[import-untyped]

from drivers.errors import PlantError
from plant_fmu.stewart import build as builder
from plant_fmu.stewart.build import build
from plant_fmu.stewart.variables import VARIABLES
from tests.broad import broad

VERSIONS = ["2.0", "3.0"]
SCHEMA = Path(fmpy.__file__).parent / "schema"
HEADERS = Path(fmpy.__file__).parent / "c-code"


@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_finds_no_problem(version):
    assert validate_fmu(str(build(version))) == []


@pytest.mark.parametrize(
    ("member", "schema"),
    [
        ("terminalsAndIcons/terminalsAndIcons.xml", "fmi3TerminalsAndIcons.xsd"),
        ("sources/buildDescription.xml", "fmi3BuildDescription.xsd"),
    ],
)
def test_terminals_and_build_description_follow_the_standards_schema(member, schema):
    with zipfile.ZipFile(build("3.0")) as archive:
        root = etree.fromstring(archive.read(member))
    etree.XMLSchema(file=str(SCHEMA / "fmi3" / schema)).assertValid(root)


@pytest.mark.parametrize(("version", "header"), [("2.0", "fmi2Functions.h"), ("3.0", "fmi3Functions.h")])
def test_every_function_of_the_standard_is_exported_and_nothing_else(version, header, tmp_path):
    text = (HEADERS / header).read_text()
    wanted = set(re.findall(r"#define (fmi[23]\w+)\s+fmi[23]FullName", text))
    assert len(wanted) > 30
    with zipfile.ZipFile(build(version)) as archive:
        name = next(n for n in archive.namelist() if n.startswith("binaries/"))
        (tmp_path / "library.so").write_bytes(archive.read(name))
    library = ctypes.CDLL(str(tmp_path / "library.so"))
    assert [n for n in sorted(wanted) if not hasattr(library, n)] == []
    assert not hasattr(library, "plant_step")


@pytest.mark.parametrize("version", VERSIONS)
def test_units_and_start_values_are_complete(version):
    description = fmpy.read_model_description(str(build(version)))
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    assert (units["N"].kg, units["N"].m, units["N"].s) == (1, 1, -2)
    for v in description.modelVariables:
        if v.causality in {"parameter", "input"}:
            assert len(str(v.start).split()) == (int(np.prod(v.shape)) if v.shape else 1)
        if v.name in {"force", "force[4]", "length", "length[1]", "rate", "rate[6]", "time"}:
            assert v.unit in {"N", "m", "m/s", "s"}
            assert v.declaredType is not None
    assert float(description.defaultExperiment.stepSize) == 1e-3
    assert {u.variable.name.split("[")[0] for u in description.outputs} == {
        v.name for v in VARIABLES if v.causality == "output"
    }


def test_direct_feedthrough_is_declared_where_it_exists():
    description = fmpy.read_model_description(str(build("3.0")))
    depends = {u.variable.name: {d.name for d in u.dependencies} for u in description.outputs}
    assert depends["acceleration"] == {"force", "brake", "wrench"}
    assert depends["applied_force"] == {"force"}
    assert depends["length"] == depends["twist"] == depends["kinetic_energy"] == set()


@pytest.mark.parametrize("version", broad(VERSIONS, quick=1))
def test_the_same_sources_give_the_same_bytes(version, tmp_path, monkeypatch):
    first = build(version).read_bytes()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    again = build(version, tmp_path / "copy.fmu")
    assert again.read_bytes() == first
    assert [p.name for p in (tmp_path / "hexapod-hil" / "fmu").glob("*/*")] == [
        f"stewart_fmi{version[0]}.fmu"
    ]


def test_the_token_follows_the_content(monkeypatch):
    before = builder.token("3.0")
    assert before == builder.token("3.0") != builder.token("2.0")
    files = builder._source_files("3.0")
    monkeypatch.setattr(builder, "_source_files", lambda _: {**files, "plant.c": files["plant.c"] + b"\n"})
    assert builder.token("3.0") != before


def test_a_binary_refuses_a_foreign_token(unpacked):
    folder, _ = unpacked
    fmu = FMU3Slave(guid="{other}", unzipDirectory=str(folder), modelIdentifier="stewart", instanceName="t")
    said = []
    with pytest.raises(Exception, match="instantiate"):
        fmu.instantiate(logMessage=lambda env, status, category, message: said.append(message))
    assert b"different builds" in said[0]


def test_the_sources_compile_without_a_warning(unpacked, tmp_path):
    folder, _ = unpacked
    compiler = builder.find_compiler()
    sources = sorted(p.name for p in (folder / "sources").glob("*.c"))
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror", "-fPIC", "-shared"]
    done = subprocess.run(
        [*compiler.command, *flags, "-o", str(tmp_path / "x.so"), *sources, "-lm"],
        cwd=folder / "sources",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_no_compiler_is_an_error_that_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(PlantError, match="pip install ziglang"):
        builder.find_compiler()


def test_a_compiler_that_fails_is_an_error_with_its_output(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    files = builder._source_files("3.0")
    monkeypatch.setattr(builder, "_source_files", lambda _: {**files, "plant.c": b"this is no C\n"})
    with pytest.raises(PlantError, match=r"(?s)exit code.*plant\.c"):
        build("3.0")
    assert list((tmp_path / "hexapod-hil" / "fmu").glob("*/*")) == []


@pytest.mark.parametrize("wanted", ['"gcc', "no-such-compiler", " "])
def test_a_compiler_that_cannot_be_called_is_named(monkeypatch, wanted):
    monkeypatch.setenv("CC", wanted)
    with pytest.raises(PlantError, match=re.escape(f"the compiler in CC={wanted!r} does not run; mend or")):
        builder.find_compiler()


@pytest.mark.parametrize("earlier", [b"", b"an earlier one"])
def test_a_copy_that_cannot_be_written_or_is_interrupted_leaves_nothing_of_itself(
    monkeypatch, tmp_path, earlier
):
    cached = build("3.0")
    out = tmp_path / "copy.fmu"
    if earlier:
        out.write_bytes(earlier)
    before = list(tmp_path.iterdir())
    error: BaseException = OSError(errno.ENOSPC, "No space left on device")

    def half(_, target):
        target.write_bytes(b"half of it")
        raise error

    monkeypatch.setattr("shutil.copyfile", half)
    with pytest.raises(PlantError) as told:
        build("3.0", out)
    assert str(told.value) == f"{out}: the FMU cannot be written: No space left on device"
    error = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        build("3.0", out)
    assert list(tmp_path.iterdir()) == before
    assert [file.read_bytes() for file in before] == [earlier][: len(before)]
    monkeypatch.undo()
    assert build("3.0", out).read_bytes() == cached.read_bytes()


@pytest.mark.parametrize(
    ("error", "raised"),
    [(OSError(errno.ENOSPC, "full"), PlantError), (KeyboardInterrupt(), KeyboardInterrupt)],
)
def test_an_fmu_that_was_packed_in_part_is_not_in_the_cache(monkeypatch, tmp_path, error, raised):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(builder, "_compile", lambda *_: b"binary")

    def half(path, *_):
        path.write_bytes(b"PK")
        raise error

    with monkeypatch.context() as changed:
        changed.setattr(builder, "_pack", half)
        with pytest.raises(raised):
            build()
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == []
    assert zipfile.is_zipfile(build())


def test_whatever_the_binary_depends_on_has_a_place_of_its_own_in_the_cache(monkeypatch, tmp_path):
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
