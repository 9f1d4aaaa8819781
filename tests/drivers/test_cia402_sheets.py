"""A data sheet is asked for each object that a run reads, writes or maps, and for the velocity's where it is used."""

from __future__ import annotations

import re

import pytest

from drivers.cia402.objects import check_eds
from drivers.errors import ConfigurationError
from tests.drivers.cia402_sheet import sheet

READ = {"0x1000:0", "0x6061:0", "0x6076:0"}
WRITTEN = {
    *("0x1016:1", "0x1017:0", "0x1400:1", "0x1400:2", "0x1600:0", "0x1800:1", "0x1800:2", "0x1A00:0"),
    *("0x6007:0", "0x605A:0", "0x605E:0", "0x6060:0", "0x6072:0"),
}
WRITTEN_OF_VELOCITY = {"0x1801:1", "0x1A01:0"}
MAPPED = {"0x6040:0", "0x6071:0", "0x6041:0", "0x6064:0", "0x6077:0"}
MAPPED_OF_VELOCITY = {"0x606C:0"}


def lacks(path, text: str, *, velocity: bool) -> dict[str, set[str]]:
    """Return what is said of the objects that a drive lacks: the words, and which they are said of."""
    path.write_text(text, encoding="ascii")
    with pytest.raises(ConfigurationError, match="the drive lacks what cia402 needs: ") as refused:
        check_eds(str(path), velocity=velocity)
    found: dict[str, set[str]] = {}
    for each in str(refused.value).partition("needs: ")[2].split("; "):
        words = re.search(r"is not there|cannot be written|cannot be mapped", each)
        assert words is not None, each
        assert each.split()[0] not in found.setdefault(words[0], set()), "told once"
        found[words[0]].add(each.split()[0])
    return found


@pytest.mark.parametrize("velocity", [True, False])
def test_what_is_missing_or_cannot_be_written_or_mapped_is_named_object_by_object(tmp_path, velocity):
    written = WRITTEN | (WRITTEN_OF_VELOCITY if velocity else set())
    mapped = MAPPED | (MAPPED_OF_VELOCITY if velocity else set())
    everything = READ | written | mapped
    path = tmp_path / "drive.eds"
    nothing = sheet(*{int(each.partition(":")[0], 16) for each in everything})
    assert lacks(path, nothing, velocity=velocity) == {"is not there": everything}
    fixed = sheet().replace("AccessType=rw", "AccessType=ro")
    assert lacks(path, fixed, velocity=velocity) == {"cannot be written": written}
    unmapped = sheet().replace("PDOMapping=1", "PDOMapping=0")
    assert lacks(path, unmapped, velocity=velocity) == {"cannot be mapped": mapped}
