"""A foreign archive: a hostile directory, or a description too large to be parsed, is refused in one sentence."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu import archive as limits
from plant_fmu.fmu.archive import check_members, open_archive
from plant_fmu.fmu.check import FmuSpec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.propose import propose
from plant_fmu.stewart.build import build

ENTRY = b"PK\1\2"
"""What an entry of a directory begins with."""


def host(path: Path) -> None:
    FmuHost(FmuSpec(path=str(path), force=["force"], length=["length"], rate=["rate"]))


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


def of_size(size: int, name: str) -> list[zipfile.ZipInfo]:
    member = zipfile.ZipInfo(name)
    member.CRC, member.file_size, member.compress_size = 0, size, size
    return [member]


@pytest.mark.parametrize("name", ["modelDescription.xml", "sources/buildDescription.xml"])
def test_a_description_of_more_than_64_mib_is_not_parsed(name: str) -> None:
    check_members(of_size(67_108_864, name), Path("a.fmu"))
    with pytest.raises(PlantError, match=rf"{name}' refused: .*67108865 bytes; at most 67108864"):
        check_members(of_size(67_108_865, name), Path("a.fmu"))


def test_a_resource_that_nobody_parses_may_be_larger() -> None:
    check_members(of_size(1_000_000_000, "resources/a.xml"), Path("a.fmu"))


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


def test_an_archive_that_is_refused_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[zipfile.ZipFile] = []

    class Archive(zipfile.ZipFile):
        def __init__(self, path: Path) -> None:
            super().__init__(path)
            opened.append(self)

    monkeypatch.setattr(zipfile, "ZipFile", Archive)
    monkeypatch.setattr(limits, "MAX_MEMBERS", 1)
    with pytest.raises(PlantError, match="at most 1 are allowed"):
        open_archive(build("3.0"))
    assert [archive.fp for archive in opened] == [None]


FMU = Path("a.fmu")
GIB = 1 << 30


def listed(*sizes: tuple[int, int]) -> list[zipfile.ZipInfo]:
    """Members of so many bytes, and so many packed."""
    members = []
    for k, (size, packed) in enumerate(sizes):
        member = zipfile.ZipInfo(f"resources/{k}")
        member.CRC, member.file_size, member.compress_size = 0, size, packed
        members.append(member)
    return members


def test_an_fmu_may_unpack_to_2_gib_in_all_and_to_no_byte_more() -> None:
    check_members(listed((GIB, GIB), (GIB, GIB)), FMU)
    with pytest.raises(PlantError, match="unpacks to 2147483649 bytes; at most 2147483648 are allowed"):
        check_members(listed((GIB, GIB), (1, 1), (GIB, GIB)), FMU)


@pytest.mark.parametrize(
    ("most", "packed"), [(1_048_576, 0), (1_048_576, 1), (1_048_800, 2_622), (40_000_000, 100_000)]
)
def test_a_member_may_have_400_times_its_packed_size_or_a_mib(most: int, packed: int) -> None:
    check_members(listed((most, packed)), FMU)
    with pytest.raises(PlantError, match="unpacks to more than 400 times its packed size"):
        check_members(listed((most + 1, packed)), FMU)


def test_20_000_members_are_not_too_many() -> None:
    sizes = [(0, 0)] * 20_000
    check_members(listed(*sizes), FMU)
    with pytest.raises(PlantError, match="20001 members; at most 20000 are allowed"):
        check_members(listed(*sizes, (0, 0)), FMU)


@pytest.mark.parametrize("second", ["resources/0", "resources/../0", "./Resources/0"])
def test_a_name_may_be_listed_twice_for_the_same_content_alone(second: str) -> None:
    both = [*listed((4, 4)), *listed((4, 4))]
    both[1].filename = second
    both[0].CRC = both[1].CRC = 7
    check_members(both, FMU)
    both[1].CRC = 8
    with pytest.raises(PlantError, match="its name occurs twice"):
        check_members(both, FMU)
