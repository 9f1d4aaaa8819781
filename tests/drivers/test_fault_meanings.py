"""Texts of fault codes, against the names in the makers' code."""

import json
import re
from pathlib import Path

import pytest

from drivers.mit.fields import ROBSTRIDE_FAULTS
from drivers.moteus import FAULTS
from drivers.odrive import ERRORS

SAID = json.loads((Path(__file__).parents[1] / "data/drives/meanings.json").read_text(encoding="utf-8"))
SAME = {
    "config": "configuration", "pwm": "pwm", "bemf": "back-emf", "accel": "acceleration", "feedforward": "feed-forward",
    "uncalibrated": "calibrated", "drv": "driver", "temp": "temperature", "regen": "regeneration", "bad": "bad",
    "estop": "emergency",
}  # fmt: skip
"""Words used here for the abbreviations of the makers."""


def words(name: str) -> list[str]:
    """Words of a name in camel case or with underscores, except those that any name may have."""
    parts = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name.replace("_", " "))
    return [SAME.get(part.lower(), part.lower()) for part in parts if part.lower() not in {"start", "limit"}]


def says(text: str, name: str) -> bool:
    """True if a text has every word of a name, even joined (over voltage, overvoltage)."""
    joined = text.lower().replace(" ", "")
    return all(word.replace(" ", "") in joined for word in words(name))


@pytest.mark.parametrize(
    ("family", "table"), [("moteus", FAULTS), ("odrive", ERRORS), ("robstride", ROBSTRIDE_FAULTS)]
)
def test_every_fault_text_contains_the_words_of_the_manufacturers_fault_name(family, table):
    names = {int(code): [said] if isinstance(said, str) else said for code, said in SAID[family].items()}
    assert sorted(table) == sorted(names)
    assert [
        (code, each) for code, several in names.items() for each in several if not says(table[code], each)
    ] == []
