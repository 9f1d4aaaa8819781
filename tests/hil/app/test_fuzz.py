"""Untrusted input, damaged at random from a seed: an answer, a HilError, never a traceback, and soon."""

import pytest

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


"""For each process of Python, in place of the targets: a reader whose process dies."""
