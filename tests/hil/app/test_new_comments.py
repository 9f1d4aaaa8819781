"""A file of `hil new` says of each number where it comes from: an answer, or a rule or custom beside it."""

from __future__ import annotations

import re

import pytest

from hil.app.new.command import new_configuration
from plant_fmu.fmu.propose import Proposal
from tests.hil.app.test_new_derived import answered

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.])")
TYPED = {
    "base_radius_m": "0.351", "platform_radius_m": "0.252", "base_half_angle_deg": "9.5",
    "platform_half_angle_deg": "8.5", "length_min_m": "0.503", "stroke_m": "0.204", "mass_kg": "42.5",
    "com_height_m": "0.013", "inertia_kg_m2": "0.71,0.72,1.13", "leg_mass_kg": "4.5", "drive_force_N": "807",
    "drive_speed_m_s": "0.308", "reflected_mass_kg": "5.25", "encoder_resolution_m": "1.1e-6",
    "brake_force_N": "809", "brake_ms": "51",
}  # fmt: skip
"""No two of them are the same, and none is what a rule or custom gives."""
MORE: dict[str, dict[str, str]] = {
    "legs": {},
    "hanging": {"mounting": "hanging"},
    "buses": {"channels": "3", "interface": "socketcan"},
    "estimate": {"inertia_kg_m2": "estimate", "rate_Hz": "333.3"},
    "cia402": {"drives": "cia402", "travel_m": "0.0123"},
    "moteus": {"drives": "moteus", "travel_m": "0.0123"},
    "odrive": {"drives": "odrive", "travel_m": "0.0123"},
    "cubemars": {"drives": "cubemars", "model": "AK80-9", "travel_m": "0.0623"},
}
WHOLE = {"operator"}
"""Sections whose comment is about each of their numbers; elsewhere that of a key's own mapping counts."""


def unexplained(text: str, answers: set[float]) -> tuple[list[str], int]:
    """Return the lines that have a number which is no answer and has no comment, and how many have one."""
    found, said, commented = list[str](), dict[int, bool](), 0
    for line in text.splitlines():
        content, mark, _ = line.partition(" #")
        if not content.strip() or content.startswith("#"):
            continue
        depth = (len(content) - len(content.lstrip())) // 2
        key, _, value = content.strip().partition(":")
        above = said.get(depth - 1, False)
        said[depth] = (bool(mark) or above) and (depth > 0 or key in WHOLE)
        numbers = (
            {float(each) for each in NUMBER.findall(value)} if key not in {"name", "description"} else set()
        )
        if "[" in value:
            numbers.discard(0.0)  # a vector or tensor with an answer in one place
        commented += bool(numbers) and bool(mark)
        if not (mark or above) and not numbers <= answers:
            found.append(line)
    return found, commented


@pytest.mark.parametrize("name", MORE)
def test_each_number_of_the_file_is_an_answer_or_has_a_comment_on_it_or_on_what_it_is_part_of(name, tmp_path):
    typed = TYPED | MORE[name]
    text, _ = new_configuration(answered(**typed), tmp_path / "r.yaml")
    given = {float(each) for value in typed.values() for each in NUMBER.findall(value)}
    found, commented = unexplained(text, given)
    assert found == []
    assert commented >= 20


def test_what_the_parameters_of_an_fmu_are_set_to_has_a_comment_too(tmp_path):
    (tmp_path / "own.fmu").touch()
    names = {key: tuple(f"{key}_{leg}" for leg in "abcdef") for key in ("force", "length", "rate")}
    proposal = Proposal("a tool", "3.0", False, names, {"force": "N"}, ("mass", "home_height", "gravity_z"))
    text, _ = new_configuration(answered(**TYPED), tmp_path / "r.yaml", (tmp_path / "own.fmu", proposal))
    assert "home_height: 0." in text
    found, _ = unexplained(text, {float(each) for value in TYPED.values() for each in NUMBER.findall(value)})
    assert found == []


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        ("a: 5", ["a: 5"]),
        ("a: 5   # why", []),
        ("s:   # why\n  a: 5", ["  a: 5"]),
        ("operator:   # why\n  a: 5", []),
        ("s:\n  t:   # why\n    a: 5\n  b: 6", ["  b: 6"]),
        ("s:\n  t:   # why\n    - {a: 5}\n  v: [0, 7]", []),
        ("s:\n  a: 7\n  b: 0", ["  b: 0"]),
    ],
)
def test_the_reading_of_comments_is_right(words, lines):
    assert unexplained(words, {7.0})[0] == lines
