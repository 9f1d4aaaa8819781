"""Unpacking an FMU: which members are taken, under which names, and that no byte more is written than announced."""

from __future__ import annotations

import lzma
import stat
import zipfile
import zlib
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.archive import extract

FMU = Path("a.fmu")


def member(name: str = "resources/a", **changes: Any) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.CRC = 0
    for key, value in changes.items():
        setattr(info, key, value)
    return info


def test_an_encrypted_member_is_refused_when_it_is_unpacked(tmp_path):
    data = BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr("resources/a", b"text")
    data.getbuffer()[6] |= 1  # of the flags in the member's own head
    data.getbuffer()[data.getvalue().rindex(b"PK\1\2") + 8] |= 1  # and of those in the directory
    with (
        zipfile.ZipFile(data) as archive,
        pytest.raises(PlantError, match=r"'resources/a' cannot be unpacked: .*encrypted"),
    ):
        extract(archive, FMU, tmp_path)


def test_extraction_stays_in_the_folder_and_links_become_text_files(tmp_path):
    link = member("link", external_attr=(stat.S_IFLNK | 0o777) << 16)
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        for name in ("../up", "/root", "a/../../side"):
            archive.writestr(name, b"x")
        archive.writestr(link, b"/etc/passwd")
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        extract(archive, FMU, tmp_path / "in/out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.fmu", "in"]
    assert [p.name for p in (tmp_path / "in").iterdir()] == ["out"]
    assert not (tmp_path / "in/out/link").is_symlink()
    assert (tmp_path / "in/out/link").read_bytes() == b"/etc/passwd"


@pytest.mark.parametrize("size", [1, 1_048_576, 2_500_000])
def test_a_member_is_unpacked_whole_and_never_beyond_what_its_header_says(tmp_path, size):
    data = bytes(range(251)) * (size // 251 + 1)
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        archive.writestr("resources/a", data)
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        extract(archive, FMU, tmp_path / "right")
        assert (tmp_path / "right/resources/a").read_bytes() == data
        archive.infolist()[0].file_size = size
        with pytest.raises(PlantError, match="'resources/a' cannot be unpacked"):
            extract(archive, FMU, tmp_path / "wrong")
    assert (tmp_path / "wrong/resources/a").stat().st_size <= size


def test_folders_are_made_once_wherever_they_are_listed(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.fmu", "w") as archive:
        for name in ("x/y/", "x/y/a", "x/", "x/b", "p/q/r", "p/q/s", "e/f/"):
            archive.writestr(name, name.encode() * (not name.endswith("/")))
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        extract(archive, FMU, tmp_path / "out")
    found = {p.relative_to(tmp_path / "out").as_posix(): p for p in (tmp_path / "out").rglob("*")}
    assert {name for name, p in found.items() if p.is_dir()} == {"x", "x/y", "p", "p/q", "e", "e/f"}
    files = {name: p.read_bytes() for name, p in found.items() if p.is_file()}
    assert files == {name: name.encode() for name in ("x/y/a", "x/b", "p/q/r", "p/q/s")}


@pytest.mark.parametrize(
    "error",
    [
        *(zipfile.BadZipFile("no"), zlib.error("no"), lzma.LZMAError("no"), OSError("no"), EOFError("no")),
        *(ValueError("no"), RuntimeError("no"), NotImplementedError("no")),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_member_that_cannot_be_read_is_named_with_the_reason(tmp_path, error):
    def broken(*_: object) -> None:
        raise error

    archive: Any = SimpleNamespace(infolist=lambda: [member()], extract=broken)
    with pytest.raises(PlantError, match=r"a\.fmu: member 'resources/a' cannot be unpacked: no"):
        extract(archive, FMU, tmp_path)
