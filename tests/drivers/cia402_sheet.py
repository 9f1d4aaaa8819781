"""The EDS file of the emulated CiA 402 drive, as shipped and without some objects."""

import re
from pathlib import Path

SHIPPED = Path(__file__).parents[2] / "drivers/cia402/emulated_drive.eds"


def sheet(*without: int) -> str:
    """The EDS file without the objects `without`."""
    sections = re.split(r"(?m)^(?=\[)", SHIPPED.read_text(encoding="ascii"))
    names = tuple(f"[{index:04X}" for index in without)
    return "".join(each for each in sections if not (names and each.startswith(names)))
