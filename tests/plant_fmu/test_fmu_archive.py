"""A foreign archive: a hostile directory, or a description too large to be parsed, is refused in one sentence."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu import archive as limits
from plant_fmu.fmu.archive import checked_members, open_archive
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.propose import propose
from plant_fmu.fmu.spec import FmuSpec
from plant_fmu.stewart.build import build

ENTRY = b"PK\1\2"
"""What an entry of a directory begins with."""


def host(path: Path) -> None:
    FmuHost(FmuSpec(path, step_s=1e-3, force=("force",), length=("length",), rate=("rate",)))


def entry(at: int, *values: int) -> bytes:
    """An archive whose only entry of the directory has these bytes there."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr("modelDescription.xml", b"<x/>")
    changed = bytearray(data.getvalue())
    begin = changed.rindex(ENTRY) + at
    changed[begin : begin + len(values)] = values
    return bytes(changed)


DIRECTORIES = {
    "a name said to be UTF-8 that is none": entry(9, 0x08).replace(b"model", b"\xff" * 5),
    "a version to come": entry(6, 255),
    "a signature that is none": entry(0, 0, 0),
}


@pytest.mark.parametrize("read", [open_archive, propose, host])
@pytest.mark.parametrize("data", DIRECTORIES.values(), ids=DIRECTORIES)
def test_a_directory_that_cannot_be_read_is_refused_in_one_sentence(
    tmp_path: Path, data: bytes, read: Callable[[Path], object]
) -> None:
    path = tmp_path / "bad.fmu"
    path.write_bytes(data)
    with pytest.raises(PlantError, match=r"bad\.fmu: not an FMU \(a ZIP archive"):
        read(path)


def of_size(size: int, name: str) -> zipfile.ZipFile:
    archive = zipfile.ZipFile(io.BytesIO(), "w")
    archive.writestr(name, b"<x/>")
    (member,) = archive.infolist()
    member.file_size = member.compress_size = size
    return archive


@pytest.mark.parametrize("name", ["modelDescription.xml", "sources/buildDescription.xml"])
def test_a_description_of_more_than_64_mib_is_not_parsed(name: str) -> None:
    assert checked_members(of_size(67_108_864, name), Path("a.fmu"))
    with pytest.raises(PlantError, match=rf"{name}' refused: .*67108865 bytes; at most 67108864"):
        checked_members(of_size(67_108_865, name), Path("a.fmu"))


def test_a_resource_that_nobody_parses_may_be_larger() -> None:
    assert checked_members(of_size(1_000_000_000, "resources/a.xml"), Path("a.fmu"))


@pytest.mark.parametrize("read", [propose, host])
def test_who_only_looks_at_an_fmu_parses_no_more_than_who_runs_it(
    monkeypatch: pytest.MonkeyPatch, read: Callable[[Path], object]
) -> None:
    parsed: list[object] = []
    monkeypatch.setattr("plant_fmu.fmu.check.read_model_description", lambda *_, **__: parsed.append(0))
    monkeypatch.setattr(limits, "MAX_XML_BYTES", 1000)
    with pytest.raises(PlantError, match=r"modelDescription\.xml' refused: .*; at most 1000 are read"):
        read(build("3.0"))
    assert not parsed
