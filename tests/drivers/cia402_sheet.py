"""The emulated CiA 402 drive's object dictionary as the text of an EDS, for tools that nobody here wrote.

`python -m tests.drivers.cia402_sheet` writes the one that is shipped.
"""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from drivers.cia402.dictionary import ENTRIES, Entry

_TYPES = {
    (1, False): 0x05,
    (2, False): 0x06,
    (4, False): 0x07,
    (1, True): 0x02,
    (2, True): 0x03,
    (4, True): 0x04,
}
_NAMES = {0x6040: "Controlword", 0x6041: "Statusword", 0x6071: "Target torque"}


def _variable(section: str, name: str, entry: Entry) -> list[str]:
    return [
        f"[{section}]",
        f"ParameterName={name}",
        "ObjectType=0x7",
        f"DataType=0x{_TYPES[entry.size, entry.signed]:04X}",
        f"AccessType={entry.access}",
        f"DefaultValue={entry.default - (1 << 8 * entry.size) if entry.signed and entry.default >> 8 * entry.size - 1 else entry.default}",
        f"PDOMapping={int(bool(entry.mappable))}",
        "",
    ]


def sheet(*without: int) -> str:
    """Return the EDS, but for the objects `without`."""
    lines: list[str] = ["[DeviceInfo]", "ProductName=emulated CiA 402 drive", "", "[Comments]", "Lines=0", ""]
    for index, keys in groupby(sorted(ENTRIES), key=lambda key: key[0]):
        if index in without:
            continue
        subs = [sub for _, sub in keys]
        name = _NAMES.get(index, f"object {index:04X}")
        if subs == [0]:
            lines += _variable(f"{index:04X}", name, ENTRIES[index, 0])
            continue
        lines += [f"[{index:04X}]", f"ParameterName={name}", "ObjectType=0x9", f"SubNumber={len(subs)}", ""]
        for sub in subs:
            lines += _variable(f"{index:04X}sub{sub:X}", f"{name} {sub}", ENTRIES[index, sub])
    return "\n".join(lines)


def write() -> None:
    """Write the shipped data sheet."""
    file = Path(__file__).parents[2] / "drivers" / "cia402" / "emulated_drive.eds"
    file.write_text(sheet() + "\n", encoding="ascii")


if __name__ == "__main__":
    write()
