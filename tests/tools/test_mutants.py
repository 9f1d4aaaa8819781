"""The tool behind `make mutants`: its changes, the list of equivalent ones, the table that a run goes on with."""

import contextlib
import json
import queue
import types
from typing import Any

import pytest

from tools.mutants import __main__ as tool
from tools.mutants import table
from tools.mutants.areas import AREAS, ROOT, Area
from tools.mutants.choice import Context
from tools.mutants.equivalent import FILE, equivalents, is_equivalent
from tools.mutants.mutant import mutants


def made(source):
    """Return every changed text of a function's body, without its first line and its indentation."""
    text = f"def f(a, b, x, i):\n    {source}\n"
    return {m.applied(text).split("\n", 1)[1].strip() for m in mutants("f.py", text)}


@pytest.mark.parametrize(
    ("source", "changed"),
    [
        ("if a < b: g()", {"if (a <= b): g()", "if (a > b): g()", "if a < b: pass"}),
        ("if a is b: g()", {"if (a is not b): g()", "if a is b: pass"}),
        ("y = a * (b + x)", {"y = (a / (b + x))", "y = a * ((b - x))"}),
        ("y = 2", {"y = 3", "y = 1", "y = 4", "y = (-2)"}),
        ("y = 1e3", {"y = 2000.0", "y = (-1000.0)", "y = 1000000.0", "y = 1.0"}),
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
        ("return a, b", {"return (b, a)"}),
    ],
)
def test_each_operator_makes_exactly_the_changes_named(source, changed):
    assert made(source) == changed


SOURCE = "def larger(a, b):\n    return max(a, b)\n\n\ndef half(a):\n    b = a / 2\n    return b\n"
CLAIMS = {"test_larger": lambda m: m.larger(1, 2) == 2, "test_half": lambda m: m.half(6) == 3}


class Toy:
    """A tree whose only module has two claims; it counts what runs."""

    def __init__(self, root):
        self.root, self.runs = root, 0
        (root / "toy.py").write_text(SOURCE)

    def changed(self, file, text):
        self.module = types.ModuleType("toy")
        self.runs += 1
        exec(text, vars(self.module))
        return contextlib.nullcontext()

    def loads(self, file, limit_s):
        return True

    def noticed_by(self, tests, limit_s):
        for test in tests:
            try:
                if not CLAIMS[test](self.module):
                    return test
            except TypeError:
                return test
        return ""


@pytest.fixture
def toy(tmp_path):
    return Toy(tmp_path)


KNOWN = [
    Context("test_larger", 0.1, {("toy.py", "larger")}, {"toy.py": 1 << 2}),
    Context("test_half", 0.1, {("toy.py", "half")}, {"toy.py": 1 << 6 | 1 << 7}),
]


def run(toy, known=KNOWN, *, again=False):
    trees: queue.Queue[Any] = queue.Queue()
    trees.put(toy)
    path = toy.root / "toy.jsonl"
    drawn, _ = tool.sampled("toy", Area(("toy.py",), ()), 1, 50, {}, toy.root)
    tool.run(drawn, known, trees, path, budget_s=1.0, again=again)
    done = table.read(path)
    return {f"{r.before} -> {r.after}": (r.outcome, r.by) for r in (done[key] for key, _ in drawn)}


def test_a_broken_claim_is_noticed_by_the_test_of_its_function(toy):
    results = run(toy)
    assert results["a / 2 -> (a * 2)"] == ("noticed", "test_half")
    assert "noticed" in {outcome for outcome, by in results.values() if by == "test_larger"}
    assert set(results.values()) == {("noticed", "test_half"), ("noticed", "test_larger")}


def test_a_run_continues_and_repeats_survivors_only_on_request(toy):
    without = [KNOWN[0]]
    first = run(toy, without)
    assert first["a / 2 -> (a * 2)"] == ("survived", "")
    count = toy.runs
    assert run(toy, KNOWN) == first
    assert toy.runs == count
    assert run(toy, KNOWN, again=True)["a / 2 -> (a * 2)"] == ("noticed", "test_half")
    assert toy.runs == count + sum(outcome == "survived" for outcome, _ in first.values())


def test_the_sample_is_the_seeds_and_has_one_change_a_place(toy):
    area = Area(("toy.py",), ())
    samples = {seed: tool.sampled("toy", area, seed, 3, {}, toy.root)[0] for seed in range(8)}
    assert samples[3] == tool.sampled("toy", area, 3, 3, {}, toy.root)[0]
    assert len({tuple(key for key, _ in sample) for sample in samples.values()}) > 1
    assert all(len({(m.start, m.end) for _, m in sample}) == 3 for sample in samples.values())


EQUIVALENT = {
    "file": "toy.py",
    "where": "larger",
    "statement": "return max(a, b)",
    "before": "max(a, b)",
    "after": "min(a, b)",
    "because": "an example",
}


def test_an_equivalent_change_is_not_drawn_wherever_its_line_is(toy):
    (toy.root / "list.json").write_text(json.dumps([EQUIVALENT]))
    (toy.root / "toy.py").write_text("\n\n" + SOURCE)
    known = equivalents(toy.root, toy.root / "list.json")
    area = Area(("toy.py",), ())
    assert any(is_equivalent(m, known) for m in mutants("toy.py", SOURCE))
    for seed in range(8):
        assert not any(
            is_equivalent(m, known) for _, m in tool.sampled("toy", area, seed, 9, known, toy.root)[0]
        )


def test_the_list_of_equivalent_changes_fits_the_sources():
    assert len(equivalents(ROOT)) == len(json.loads(FILE.read_text()))


@pytest.mark.parametrize("area", AREAS)
def test_every_area_has_sources_and_tests(area):
    assert AREAS[area].source_files()
    assert AREAS[area].test_files()
