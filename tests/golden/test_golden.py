"""Every golden case gives its frozen frames and columns, and replays to the bit."""

import pytest

from tests.golden.cases import CASES, QUICK
from tests.golden.freeze import CPU, expected
from tests.golden.runner import differences, digests, replayed, run


def test_every_golden_case_has_stored_reference_results():
    assert set(expected()["cases"]) == set(CASES), "python -m tests.golden.freeze adds what is missing"
    assert set(CASES) >= QUICK


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in CASES]
)
def test_golden_case_reproduces_its_stored_frames_and_columns_and_replays(name):
    kept = expected()
    trace = run(CASES[name])
    comparison = replayed(CASES[name], trace)
    found = differences(kept["cases"][name], digests(trace), same_cpu=kept["cpu"] == CPU)
    if found:
        pytest.fail("\n".join(found), pytrace=False)
    assert comparison.exact, "\n".join(map(str, comparison.first))
