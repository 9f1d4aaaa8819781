"""Untrusted input, damaged at random from a seed: an answer, a HilError, never a traceback, and soon."""

import string

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load, loads
from tools.fuzz import case
from tools.fuzz.targets import TARGETS, stock

QUICK = {"log": 25, "configuration": 12, "csv": 20, "controller": 8, "fmu": 6, "operator": 6}

"""Cases of each kind; `make fuzz` runs thousands."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return stock(tmp_path_factory.mktemp("stock"), duration_s=0.05)


@pytest.mark.parametrize("target", TARGETS)
def test_damaged_input_is_answered(sound, target):
    results = [case.run(seed, sound, target) for seed in range(QUICK[target])]
    assert [r for r in results if r.problem not in {"", "hang"}] == []
    slow = [r for r in results if r.seconds > case.LONGEST_S]
    assert len(slow) < 3  # a first time may compile


@pytest.mark.long
@pytest.mark.parametrize("target", TARGETS)
def test_damaged_input_is_answered_from_many_seeds(sound, target):
    results = [case.run(seed, sound, target) for seed in range(1000, 1000 + 20 * QUICK[target])]
    assert [r for r in results if r.problem] == []


TEXT = load("ideal").text

LINES = TEXT.splitlines()

WORDS = st.sampled_from([
    *("", "x", "-", "[", "]", "{", "}", ":", "? ", "*a", "&a", "!t", "|", "'", '"', "\t", "%", "@", ".nan", "1e999", "~"),
    *("[1, [2]]", "{a: b}", "null", "true", "-0", "9" * 400, "\u00e9", "\u2028", "\ufeff", "0x", "1e", "...", "---", "#"),
])  # fmt: skip


@st.composite
def damaged(draw):
    """The text with one to three lines changed in their value, their indentation or as a whole."""
    lines = list(LINES)
    for _ in range(draw(st.integers(1, 3))):
        k = draw(st.integers(0, len(lines) - 1))
        word = draw(WORDS | st.text(string.printable, max_size=6))
        key = lines[k].partition(":")[0]
        lines[k] = draw(
            st.sampled_from([word, f"{key}: {word}", f"{lines[k]}{word}", f" {lines[k]}", lines[k].lstrip()])
        )
        if draw(st.booleans()):
            del lines[draw(st.integers(0, len(lines) - 1))]
    return "\n".join(lines) + "\n"


@settings(max_examples=200)
@given(damaged())
def test_a_damaged_file_never_ends_in_a_traceback(text):
    found: tuple[str, ...] = ()
    try:
        loads(text, "damaged.yaml")
    except ConfigurationError as error:
        found = error.problems or ("an error without a problem",)
    for problem in found:
        place, line, column = problem.split(":")[:3]
        assert place == "damaged.yaml"
        assert 1 <= int(line) <= text.count("\n") + 2
        assert int(column) >= 1
