"""The directory of a foreign archive: one that is hostile is refused in one sentence."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import PlantError
from plant_fmu.fmu.archive import open_archive
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.propose import propose
from plant_fmu.fmu.spec import FmuSpec

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
