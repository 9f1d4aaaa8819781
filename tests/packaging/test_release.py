"""The distributions of a release: the same bytes twice, and FMU binaries for five platforms."""

from __future__ import annotations

import re
import tomllib
import zipfile
from pathlib import Path

import fmpy
import pytest

from tools import release

PLATFORMS = {
    "linux64": "ELF X86_64",
    "x86_64-linux": "ELF X86_64",
    "aarch64-linux": "ELF AARCH64",
    "win64": "PE AMD64",
    "x86_64-windows": "PE AMD64",
    "darwin64": "MACHO X86_64",
    "x86_64-darwin": "MACHO X86_64",
    "aarch64-darwin": "MACHO ARM64",
}
"""Folder of a binary in an FMU -> format and processor."""
HEADERS = Path(fmpy.__file__).parent / "c-code"


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Wheel and sdist of HEAD, built twice in different folders with empty caches of FMUs."""
    pytest.importorskip("ziglang")
    folders = [tmp_path_factory.mktemp(name) for name in ("first", "second_and_longer")]
    for folder in folders:
        release.build(folder)
    return [{path.name: path for path in folder.iterdir()} for folder in folders]


@pytest.mark.long
def test_two_builds_of_sdist_and_wheel_are_equal_in_every_byte(wheels):
    first, second = wheels
    assert {n: p.read_bytes() for n, p in first.items()} == {n: p.read_bytes() for n, p in second.items()}
    assert {path.suffix for path in first.values()} == {".whl", ".gz"}


def kind(binary):
    """Format and processor of a parsed binary."""
    machine = {"ELF": "machine_type", "PE": "machine", "MACHO": "cpu_type"}[binary.format.name]
    return f"{binary.format.name} {getattr(binary.header, machine).name}"


@pytest.mark.long
@pytest.mark.parametrize(("version", "header"), [("2", "fmi2Functions.h"), ("3", "fmi3Functions.h")])
def test_wheel_has_the_fmu_for_five_platforms_each_with_every_fmi_function(wheels, version, header):
    lief = pytest.importorskip("lief")
    wanted = set(re.findall(r"#define (fmi[23]\w+)\s+fmi[23]FullName", (HEADERS / header).read_text()))
    (wheel,) = (path for name, path in wheels[0].items() if name.endswith(".whl"))
    with (
        zipfile.ZipFile(wheel) as archive,
        archive.open(f"plant_fmu/stewart/stewart_fmi{version}.fmu") as fmu,
    ):
        inside = zipfile.ZipFile(fmu)
        binaries = {n.split("/")[1]: inside.read(n) for n in inside.namelist() if n.startswith("binaries/")}
    assert len(binaries) == 5
    for folder, data in binaries.items():
        binary = lief.parse(data)
        assert kind(binary) == PLATFORMS[folder]
        exported = {function.name.removeprefix("_") for function in binary.exported_functions}
        assert wanted <= exported, (folder, wanted - exported)
        assert "plant_step" not in exported


def test_release_with_placeholders_or_without_tag_is_refused(monkeypatch):
    monkeypatch.setattr(release, "run", lambda *_, **__: "")
    found = " ".join(release.obstacles())
    urls = tomllib.loads((release.ROOT / "pyproject.toml").read_text())["project"]["urls"]
    assert ("placeholders" in found) == any("example.invalid" in url for url in urls.values())
    assert "HEAD has no tag v" in found


@pytest.mark.parametrize(
    ("licence", "refused"),
    [
        ("GPL-3.0-only", True),
        ("GNU General Public License v3 (GPLv3)", True),
        ("AGPL-3.0-or-later", True),
        ("LGPL-3.0-only", False),
        ("GNU Lesser General Public License v3 (LGPLv3)", False),
        ("BSD-3-Clause", False),
    ],
)
def test_licences_of_the_gpl_are_told_from_the_lesser_one(licence, refused):
    assert bool(release.GPL.search(licence)) is refused
