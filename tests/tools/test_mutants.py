"""The tool behind `make mutants`: its changes, its areas and its sample."""

import pytest

from tools.mutants.__main__ import AREAS, own_tests, sampled, sources_of
from tools.mutants.mutant import mutants


def made(source):
    """Every changed text of a function's body, without its first line and its indentation."""
    text = f"def f(a, b, x, i):\n    {source}\n"
    return {m.applied(text).split("\n", 1)[1].strip() for m in mutants("f.py", text)}


@pytest.mark.parametrize(
    ("source", "changed"),
    [
        ("if a < b: g()", {"if (a <= b): g()", "if (a > b): g()", "if a < b: pass"}),
        ("if a is b: g()", {"if (a is not b): g()", "if a is b: pass"}),
        ("y = a * (b + x)", {"y = (a / (b + x))", "y = a * ((b - x))"}),
        ("y = 2", {"y = 3", "y = 1", "y = 4", "y = (-2)"}),
        ("y = 1e3", {"y = 2000.0", "y = 500.0", "y = (-1000.0)"}),
        ("y = a and b", {"y = (a or b)"}),
        ("y = not a", {"y = a"}),
        ("y = -a", {"y = a"}),
        ("y = True", {"y = False"}),
        ("y = min(a, b)", {"y = max(a, b)"}),
        ("y = np.minimum(a, b)", {"y = np.maximum(a, b)"}),
        ("y = abs(a)", {"y = a"}),
        ("y = g(a, b)", {"y = g(b, a)"}),
        ("y = x[i]", {"y = x[0]"}),
        ("a += b", {"a -= b", "pass"}),
        ("raise ValueError(a - b)", {"pass"}),
    ],
)
def test_each_mutation_operator_makes_exactly_the_expected_changes(source, changed):
    assert made(source) == changed


@pytest.mark.parametrize("area", AREAS)
def test_every_area_of_the_mutation_tool_has_sources_and_tests(area):
    assert sources_of(area)
    assert own_tests(area)


def test_seed_always_draws_the_same_mutants_each_at_a_different_place():
    drawn = [mutant for _, mutant in sampled("record", 1, 30)]
    assert drawn == [mutant for _, mutant in sampled("record", 1, 30)]
    assert len({(m.file, m.start, m.end) for m in drawn}) == 30
