"""Texts of fault codes, against the names in the makers' code."""

import json
import re
from pathlib import Path

import pytest

from drivers.cia402.states import meaning
from drivers.mit.fields import CUBEMARS_FAULTS, DAMIAO_FAULTS, ROBSTRIDE_FAULTS
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


@pytest.mark.parametrize(
    ("table", "names"),
    [
        (
            CUBEMARS_FAULTS,
            ["over_temperature", "over_current", "over_voltage", "under_voltage", "encoder", "unbalance"],
        ),
        (
            {code - 7: text for code, text in DAMIAO_FAULTS.items()},
            [
                *("over_voltage", "under_voltage", "over_current", "MOSFET_over_temperature"),
                *("rotor_over_temperature", "lost_communication", "overload"),
            ],
        ),
    ],
)
def test_fault_texts_of_cubemars_and_damiao_drives_follow_the_order_of_their_manuals(table, names):
    assert sorted(table) == list(range(1, len(names) + 1))
    assert all(says(table[code], name) for code, name in enumerate(names, start=1)), table


EMCY = {
    0x2310: "over current", 0x2320: "short circuit", 0x3110: "mains over-voltage", 0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage", 0x3220: "DC link under-voltage", 0x4210: "temperature of the device",
    0x4310: "temperature of the drive", 0x5441: "enable input", 0x7121: "blocked", 0x7305: "encoder 1",
    0x7310: "speed", 0x7380: "position sensor", 0x8110: "overrun", 0x8120: "error passive", 0x8130: "heartbeat",
    0x8140: "recovered from bus off", 0x8150: "collision", 0x8210: "not processed", 0x8220: "exceeded",
    0x8250: "timeout", 0x8311: "excess torque", 0x8400: "speed controller", 0x8500: "position controller",
    0x8611: "following error", 0x8612: "reference limit", 0x8700: "sync controller",
    0x21FF: "input side", 0x22FF: "inside the device", 0x23FF: "output side", 0x31FF: "mains voltage",
    0x32FF: "voltage inside", 0x33FF: "output voltage", 0x41FF: "ambient", 0x42FF: "of the device",
    0x43FF: "of the drive", 0x50FF: "hardware", 0x61FF: "internal software", 0x62FF: "user software",
    0x63FF: "data set", 0x71FF: "power", 0x73FF: "sensor", 0x81FF: "communication", 0x82FF: "protocol",
    0x83FF: "torque", 0x84FF: "velocity", 0x85FF: "position", 0x86FF: "positioning", 0x87FF: "synchronisation",
    0x90FF: "external", 0xF0FF: "additional", 0xFFFF: "manual",
}  # fmt: skip
"""Words required for codes of CiA 301, table 26, and CiA 402-2, and for one code of each class."""


def test_canopen_fault_texts_contain_the_words_of_each_error_code_and_class():
    assert meaning(0x00EE) == meaning(0xEFEE) == "unknown"
    assert {code: meaning(code) for code, said in EMCY.items() if said not in meaning(code)} == {}
