"""The words of fault codes, against the names that their makers' code gives them."""

import json
import re
from pathlib import Path

import pytest

from drivers.mit.variants import ROBSTRIDE_FAULTS
from drivers.moteus import FAULTS
from drivers.odrive import ERRORS

SAID = json.loads((Path(__file__).parents[1] / "data/drives/meanings.json").read_text(encoding="utf-8"))
SAME = {
    "config": "configuration", "pwm": "pwm", "bemf": "back-emf", "accel": "acceleration", "feedforward": "feed-forward",
    "uncalibrated": "calibrated", "drv": "driver", "temp": "temperature", "regen": "regeneration", "bad": "bad",
    "estop": "emergency",
}  # fmt: skip
"""What a maker's abbreviation is called here."""


def words(name: str) -> list[str]:
    """Return the words of a name in camel case or with underscores, without those that every name may have."""
    parts = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name.replace("_", " "))
    return [SAME.get(part.lower(), part.lower()) for part in parts if part.lower() not in {"start", "limit"}]


def says(text: str, name: str) -> bool:
    """Tell whether a text has every word of a name, be it in one piece (over voltage, overvoltage)."""
    joined = text.lower().replace(" ", "")
    return all(word.replace(" ", "") in joined for word in words(name))


@pytest.mark.parametrize(
    ("family", "table"), [("moteus", FAULTS), ("odrive", ERRORS), ("robstride", ROBSTRIDE_FAULTS)]
)
def test_every_code_of_a_maker_has_a_meaning_and_no_other_has(family, table):
    assert sorted(table) == sorted(map(int, SAID[family]))


@pytest.mark.parametrize(("code", "name"), SAID["moteus"].items())
def test_moteus_words_are_the_firmwares(code, name):
    assert says(FAULTS[int(code)], name), (FAULTS[int(code)], name)


@pytest.mark.parametrize(("bit", "name"), SAID["odrive"].items())
def test_odrive_words_are_those_of_its_dbc(bit, name):
    assert says(ERRORS[int(bit)], name), (ERRORS[int(bit)], name)


@pytest.mark.parametrize(("bit", "names"), SAID["robstride"].items())
def test_robstride_words_are_those_of_both_of_its_makers_programs(bit, names):
    for name in names:
        assert says(ROBSTRIDE_FAULTS[int(bit)], name), (ROBSTRIDE_FAULTS[int(bit)], name)
