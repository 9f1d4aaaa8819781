"""Which C compiler makes our FMU, how it is called for each machine, and what of it the archive holds where."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import PlantError
from plant_fmu.stewart import build as builder
from plant_fmu.stewart.build import Compiler
from plant_fmu.stewart.description import model_description

ZIG = (sys.executable, "-m", "ziglang")
MACHINES = {
    "linux-x86_64": ("linux64", "x86_64-linux", "stewart.so"),
    "linux-aarch64": ("aarch64-linux", "aarch64-linux", "stewart.so"),
    "windows-x86_64": ("win64", "x86_64-windows", "stewart.dll"),
    "darwin-x86_64": ("darwin64", "x86_64-darwin", "stewart.dylib"),
    "darwin-aarch64": ("aarch64-darwin", "aarch64-darwin", "stewart.dylib"),
}
"""Folders of the binaries in FMI 2.0 and 3.0, and their file."""
ALONE_2 = {"linux": "linux64", "windows": "win64", "darwin": "darwin64"}
"""FMI 2.0 has no name for a processor but x86: importers look there whatever it is."""


def found(
    monkeypatch: pytest.MonkeyPatch, works: set[tuple[str, ...]], cc: str | None, *, zig: bool
) -> Compiler:
    """Find a compiler where these commands work, and the path has this cc."""

    def identity(command: tuple[str, ...], argument: str) -> str | None:
        return f"{argument} of {command[-1]}" if command in works else None

    monkeypatch.setattr(builder, "_identity", identity)
    monkeypatch.setattr("shutil.which", lambda name: cc if name == "cc" else None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name == "ziglang" or None)
    return builder.find_compiler(zig=zig)


OWN, CC = ("tcc", "-m64"), ("/usr/bin/cc",)
OWN_FOUND = Compiler(OWN, zig=False, identity="--version of -m64")
CC_FOUND = Compiler(CC, zig=False, identity="--version of /usr/bin/cc")
ZIG_FOUND = Compiler((*ZIG, "cc"), zig=True, identity="version of ziglang")


@pytest.mark.parametrize(
    ("wanted", "works", "cc", "zig", "expected"),
    [
        ("tcc -m64", {OWN, CC, ZIG}, CC[0], False, OWN_FOUND),
        (None, {OWN, CC, ZIG}, CC[0], False, CC_FOUND),
        (None, {OWN, ZIG}, CC[0], False, ZIG_FOUND),
        (None, {ZIG}, None, False, ZIG_FOUND),
        ("tcc -m64", {OWN, CC, ZIG}, CC[0], True, ZIG_FOUND),
    ],
)
def test_the_compiler_is_the_one_that_is_asked_for_or_that_of_the_system_or_else_zig(
    monkeypatch, wanted, works, cc, zig, expected
):
    if wanted is None:
        monkeypatch.delenv("CC", raising=False)
    else:
        monkeypatch.setenv("CC", wanted)
    assert found(monkeypatch, works, cc, zig=zig) == expected


@pytest.mark.parametrize(("zig", "missing"), [(False, r"C compiler \(cc, or zig"), (True, "zig found")])
def test_where_zig_does_not_run_either_it_is_said_what_is_missing(monkeypatch, zig, missing):
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(PlantError, match=f"no {missing}"):
        found(monkeypatch, {CC} if zig else set(), CC[0], zig=zig)


def test_a_compiler_that_answers_and_fails_is_none(monkeypatch):
    monkeypatch.setenv("CC", "sh -c 'echo version 9; exit 1'")
    with pytest.raises(PlantError, match="does not run; mend or unset CC"):
        builder.find_compiler()
    monkeypatch.setenv("CC", "sh -c 'echo version 9; exit 0'")
    assert builder.find_compiler().identity == "sh -c 'echo version 9; exit 0'\nversion 9\n"


@pytest.mark.parametrize("zig", [False, True])
@pytest.mark.parametrize("key", MACHINES)
def test_a_machine_has_its_target_and_the_flags_that_its_libraries_need(monkeypatch, tmp_path, key, zig):
    called: list[Sequence[str]] = []

    def run(command: Sequence[str], **_: Any) -> Any:
        called.append(command)
        Path(command[command.index("-o") + 1]).write_bytes(b"made")
        return SimpleNamespace(returncode=0)

    monkeypatch.setattr(subprocess, "run", run)
    compiler = Compiler(("compile", "it"), zig=zig, identity="")
    assert builder._compile(compiler, key, tmp_path, ["a.c", "b.c"]) == b"made"
    ((*command,),) = called
    assert command[:2] == ["compile", "it"]
    assert set(builder.FLAGS) < set(command)
    assert command[command.index("-o") + 2 :][:2] == ["a.c", "b.c"]
    system = key.split("-")[0]
    assert ("-fPIC" in command) == (system == "linux")
    assert ("-lm" in command) == (system != "windows")
    targets = [after for flag, after in pairwise(command) if flag == "-target"]
    assert targets == ([builder.TARGETS[key].zig] if zig else [])
    machine = {"x86_64": "x86_64-", "aarch64": "aarch64-"}[key.split("-")[1]]
    assert builder.TARGETS[key].zig.startswith(machine + {"darwin": "macos"}.get(system, system))


def packed(version: str, keys: Sequence[str], out: Path) -> list[zipfile.ZipInfo]:
    binaries = {key: key.encode() for key in keys}
    builder._pack(out, version, binaries, {"b.c": b"b", "a.h": b"a"}, "{token}")  # type: ignore[arg-type]
    with zipfile.ZipFile(out) as archive:
        for name in archive.namelist():
            if name.startswith("binaries/"):
                assert archive.read(name).decode() in keys
        return archive.infolist()


@pytest.mark.parametrize("key", MACHINES)
def test_a_binary_lies_where_importers_look_for_it_alone_and_among_others(tmp_path, key):
    in_2, in_3, file = MACHINES[key]
    for version, keys, folder in (
        ("2.0", [key], ALONE_2[key.split("-")[0]]),
        ("2.0", list(MACHINES), in_2),
        ("3.0", [key], in_3),
        ("3.0", list(MACHINES), in_3),
    ):
        names = [member.filename for member in packed(version, keys, tmp_path / "a.fmu")]
        assert f"binaries/{folder}/{file}" in names
        assert sum(name.startswith("binaries/") for name in names) == len(keys)
        assert [name for name in names if name.endswith((".c", ".h"))] == ["sources/a.h", "sources/b.c"]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_members_say_nothing_of_when_and_by_whom_they_were_packed(tmp_path, version):
    members = packed(version, ["linux-x86_64"], tmp_path / "a.fmu")
    assert {(m.date_time, m.external_attr >> 16, m.compress_type) for m in members} == {
        ((2000, 1, 1, 0, 0, 0), 0o644, zipfile.ZIP_DEFLATED)
    }


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_token_changes_with_each_source_and_with_what_is_made_of_the_table(monkeypatch, version):
    files = builder._source_files(version)
    tokens = {builder.token(version)}
    assert {"model.c", "model.h", f"fmi{version[0]}.c"} < set(files)
    for name, data in files.items():
        with monkeypatch.context() as changed:
            changed.setattr(
                builder, "_source_files", lambda _, name=name, data=data: {**files, name: data + b"\n"}
            )
            tokens.add(builder.token(version))
    assert len(tokens) == 1 + len(files)
    for name in ("tables", "header"):
        made = getattr(builder, name)
        with monkeypatch.context() as changed:
            changed.setattr(builder, name, lambda *given, made=made: made(*given) + "\n")
            tokens.add(builder.token(version))
    assert len(tokens) == 1 + len(files), "the same change, by the program that makes it"
    assert builder.token(version) in tokens


def test_a_failed_compilation_reports_the_last_2000_characters(monkeypatch, tmp_path):
    said = "x" * 10 + "y" * 2000
    asked: dict[str, Any] = {}

    def run(*_: Any, **options: Any) -> Any:
        asked.update(options)
        return SimpleNamespace(returncode=3, stderr=f"  {said}\n ")

    monkeypatch.setattr(subprocess, "run", run)
    with pytest.raises(PlantError) as told:
        builder._compile(CC_FOUND, "linux-x86_64", tmp_path, ["a.c"])
    first, command, rest = str(told.value).split("\n")
    assert first == "compiling the plant for linux-x86_64 failed with exit code 3:"
    assert command.startswith("/usr/bin/cc -O2 ")
    assert rest == "y" * 2000
    assert (asked["capture_output"], asked["text"], asked["cwd"]) == (True, True, tmp_path)


def test_a_machine_without_a_target_is_refused(monkeypatch):
    for key in ("linux-x86_64", "linux-aarch64"):
        monkeypatch.setattr("platform.machine", lambda key=key: key.split("-")[1])
        assert builder.this_machine() == key
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    with pytest.raises(PlantError, match="can be built for linux-riscv64; allowed are linux-x86_64, "):
        builder.this_machine()


@pytest.mark.parametrize(("version", "other"), [("2.0", "3.0"), ("3.0", "2.0")])
def test_the_token_follows_the_description_of_its_own_version_alone(monkeypatch, version, other):
    before = {each: builder.token(each) for each in (version, other)}
    asked: list[Any] = []

    def described(of: Any, token: str, sources: Sequence[str]) -> bytes:
        asked.append((token, sorted(sources)))
        return b"another" if of == version else model_description(of, token, sources)

    monkeypatch.setattr(builder, "model_description", described)
    assert builder.token(version) != before[version]
    units = ["contact.c", f"fmi{version[0]}.c", "mechanics.c", "model.c", "plant.c"]
    assert asked == [("", units)]
    assert builder.token(other) == before[other]


def test_a_cache_that_cannot_be_written_is_said_with_what_to_set(monkeypatch, tmp_path):
    def refuse(_: Path) -> None:
        raise OSError("read-only file system")

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(builder, "made_folder", refuse)
    with pytest.raises(PlantError, match=r"could not be written: read-only file system; set XDG_CACHE_HOME"):
        builder.build("3.0")
