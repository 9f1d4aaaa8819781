"""Foreign archives: damaged, too large or ambiguous ones are refused, and extraction stays in its folder."""

from __future__ import annotations

import io
import stat
import zipfile
from pathlib import Path

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.archive import check_members, extract, open_archive

FMU = Path("a.fmu")
GIB, MIB = 1 << 30, 1 << 20


def directory(at: int, *values: int) -> bytes:
    """Make an archive with these bytes at an offset in its only directory entry."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr("modelDescription.xml", b"<x/>")
    changed = bytearray(data.getvalue())
    begin = changed.rindex(b"PK\1\2") + at
    changed[begin : begin + len(values)] = values
    return bytes(changed)


DAMAGED = {
    "text": b"no archive",
    "invalid UTF-8 name": directory(9, 0x08).replace(b"model", b"\xff" * 5),
    "future version": directory(6, 255),
    "wrong signature": directory(0, 0, 0),
}


@pytest.mark.parametrize("data", DAMAGED.values(), ids=DAMAGED)
def test_damaged_fmu_archive_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bad.fmu"
    path.write_bytes(data)
    with pytest.raises(PlantError, match=r"bad\.fmu: not an FMU"):
        open_archive(path)


def test_fmu_path_that_is_missing_or_a_folder_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.fmu", tmp_path):
        with pytest.raises(PlantError, match="no such file"):
            open_archive(path)


def members(*sizes: tuple[int, int], name: str = "resources/{}") -> list[zipfile.ZipInfo]:
    """Make members of these sizes, unpacked and packed."""
    found = []
    for k, (size, packed) in enumerate(sizes):
        member = zipfile.ZipInfo(name.format(k))
        member.CRC, member.file_size, member.compress_size = 0, size, packed
        found.append(member)
    return found


BORDERS = {
    "2 GiB in all": (members((GIB, GIB), (GIB, GIB)), members((GIB, GIB), (1, 1), (GIB, GIB)), "unpacks to"),
    "20000 members": (members(*[(0, 0)] * 20_000), members(*[(0, 0)] * 20_001), "20001 members"),
    "1 MiB at any ratio": (members((MIB, 0)), members((MIB + 1, 0)), "400 times"),
    "ratio 400": (members((40_000_000, 100_000)), members((40_000_001, 100_000)), "400 times"),
    **{
        f"64 MiB of {name}": (
            members((64 * MIB, 64 * MIB), name=name),
            members((64 * MIB + 1, 64 * MIB + 1), name=name),
            "at most 67108864 are read",
        )
        for name in ("modelDescription.xml", "sources/buildDescription.xml")
    },
}


@pytest.mark.parametrize(("allowed", "refused", "word"), BORDERS.values(), ids=BORDERS)
def test_fmu_archive_with_too_many_too_large_or_too_compressed_members_is_refused(
    allowed: list[zipfile.ZipInfo], refused: list[zipfile.ZipInfo], word: str
) -> None:
    check_members(allowed, FMU)
    with pytest.raises(PlantError, match=word):
        check_members(refused, FMU)


@pytest.mark.parametrize("second", ["resources/0", "resources/../0", "./Resources/0"])
def test_repeated_member_of_an_fmu_archive_is_refused_if_its_content_differs(second: str) -> None:
    both = [*members((4, 4)), *members((4, 4))]
    both[1].filename = second
    check_members(both, FMU)
    both[1].CRC = 8
    with pytest.raises(PlantError, match="occurs twice"):
        check_members(both, FMU)


def test_fmu_archive_is_extracted_only_into_its_folder_and_links_become_text_files(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        for name in ("../up", "/root", "a/../../side", "x/y/", "x/y/a"):
            archive.writestr(name, b"x" * (not name.endswith("/")))
        archive.writestr(link, b"/etc/passwd")
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        extract(archive, FMU, tmp_path / "in/out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.fmu", "in"]
    assert [p.name for p in (tmp_path / "in").iterdir()] == ["out"]
    assert (tmp_path / "in/out/x/y/a").read_bytes() == b"x"
    assert not (tmp_path / "in/out/link").is_symlink()
    assert (tmp_path / "in/out/link").read_bytes() == b"/etc/passwd"


@pytest.mark.parametrize("size", [1, MIB, 2_500_000])
def test_fmu_archive_member_never_unpacks_beyond_the_size_in_its_header(tmp_path: Path, size: int) -> None:
    data = bytes(range(251)) * (size // 251 + 1)
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr("resources/a", data)
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        extract(archive, FMU, tmp_path / "right")
        assert (tmp_path / "right/resources/a").read_bytes() == data
        archive.infolist()[0].file_size = size
        with pytest.raises(PlantError, match="cannot be unpacked"):
            extract(archive, FMU, tmp_path / "wrong")
    assert (tmp_path / "wrong/resources/a").stat().st_size <= size
