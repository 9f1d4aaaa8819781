"""The tool behind `make mutants`: its changes, the list of equivalent ones, the table that a run goes on with."""

import contextlib
import json
import queue
import types
from typing import Any

import pytest

from tools.mutants import __main__ as tool
from tools.mutants import choice, table
from tools.mutants.areas import AREAS, ROOT, Area
from tools.mutants.choice import Context, chosen, contexts
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
        ("y = g(a, a)", set()),
        ("y = x[i]", {"y = x[0]"}),
        ("a += b", {"a -= b", "pass"}),
        ("x.y = a", {"pass"}),
        ("raise ValueError(a - b)", {"pass"}),
        ("return a, b", {"return (b, a)"}),
        ("return a", {"return None"}),
        ("y = a if b else x", {"y = (x if b else a)"}),
        ("y: 'int | None' = a", set()),
        ("y = f'{a + 1}' + 'ä'", set()),
        ("y = 'ä', a - b", {"y = 'ä', (a + b)"}),
    ],
)
def test_each_operator_makes_exactly_the_changes_named(source, changed):
    assert made(source) == changed


def test_docstrings_decorators_types_and_messages_stay():
    text = '"""3."""\nfrom a import b\n@c(4)\ndef f(x: d[5]) -> e[6]:\n    """7."""\n    assert x, 8\n'
    assert list(mutants("f.py", text)) == []


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


def test_a_change_that_breaks_a_claim_is_noticed_by_the_claim_of_its_function(toy):
    results = run(toy)
    assert results["a / 2 -> (a * 2)"] == ("noticed", "test_half")
    assert "noticed" in {outcome for outcome, by in results.values() if by == "test_larger"}
    assert set(results.values()) == {("noticed", "test_half"), ("noticed", "test_larger")}


def test_a_run_goes_on_where_the_last_ended_and_repeats_survivors_only_when_asked(toy):
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


@pytest.mark.parametrize("other", [{"statement": "return max(b, a)"}, {"because": ""}, {"file": "gone.py"}])
def test_an_equivalent_change_of_a_source_that_differs_or_without_argument_is_refused(toy, other):
    (toy.root / "list.json").write_text(json.dumps([{**EQUIVALENT, **other}]))
    with pytest.raises(SystemExit, match="judge the place again"):
        equivalents(toy.root, toy.root / "list.json")


def test_the_list_of_equivalent_changes_fits_the_sources():
    assert len(equivalents(ROOT)) == len(json.loads(FILE.read_text()))


def test_tests_of_the_line_come_first_then_of_the_function_then_of_the_file_within_the_budget():
    (mutant,) = [m for m in mutants("toy.py", SOURCE) if m.after == "(a * 2)"]
    function = {("toy.py", "half")}
    known = [
        Context("a.py::function", 0.1, function),
        Context("b.py::dear", 5.0, function, {"toy.py": 1 << 6}),
        Context("c.py::cheap", 0.2, function, {"toy.py": 1 << 6}),
        Context("d.py::other", 0.1, {("toy.py", "larger")}, {"toy.py": 1 << 2}),
    ]
    assert [c.test for c in chosen(mutant, known, 9.0)] == [
        "c.py::cheap",
        "b.py::dear",
        "a.py::function",
        "d.py::other",
    ]
    assert [c.test for c in chosen(mutant, known, 1.0)] == ["c.py::cheap", "a.py::function", "d.py::other"]


def test_a_test_that_fails_unchanged_is_never_chosen_and_fixtures_count_for_all_of_their_file(tmp_path):
    ran = {"functions": {"toy.py": ["half"]}, "lines": {"toy.py": hex(1 << 6)}}
    none: dict[str, Any] = {"functions": {}, "lines": {}}
    lines = [
        {"test": "t.py::good", "seconds": 1.0, "passed": True, **none},
        {"test": "t.py::red", "seconds": 1.0, "passed": False, **none},
        {"file": "t.py", **ran},
    ]
    path = tmp_path / "t.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)))
    (context,) = contexts([path])
    assert context == Context("t.py::good", 1.0, {("toy.py", "half")}, {"toy.py": 1 << 6})


def test_wilsons_interval_is_that_of_the_literature():
    # Newcombe, Statistics in Medicine 17 (1998) 857-872, table I: method 3
    for hits, count, low, high in [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
    ]:
        assert table.wilson(hits, count) == pytest.approx((low, high), abs=5e-5)


def test_a_line_of_the_table_that_was_cut_short_is_run_again(toy):
    run(toy)
    path = toy.root / "toy.jsonl"
    text = path.read_text()
    path.write_text(text[: len(text) - 9])
    count = toy.runs
    run(toy)
    assert toy.runs == count + 1


@pytest.mark.parametrize("area", AREAS)
def test_every_area_has_sources_and_tests(area):
    assert AREAS[area].source_files()
    assert AREAS[area].test_files()


def test_what_no_test_is_seen_to_run_is_judged_by_the_tests_of_its_users_the_nearest_first(monkeypatch):
    monkeypatch.setattr(choice, "users", lambda file: ["near.py", "far.py"])
    plain = "def twice(a):\n    return 2 * a\n"
    known = [
        Context("t.py::far", 0.1, {("far.py", "g")}),
        Context("t.py::near", 0.2, {("near.py", "f")}),
        Context("t.py::none", 0.1),
    ]
    for text in (f"@kernel(REAL)\n{plain}", plain):  # what another process runs is not seen either
        found = {tuple(c.test for c in chosen(m, known, 9.0)) for m in mutants("twice.py", text)}
        assert found == {("t.py::near", "t.py::far")}
    assert {tuple(c.test for c in chosen(m, known, 9.0)) for m in mutants("b.py", "A = 2\n")} == {
        ("t.py::near", "t.py::far")
    }


def test_the_summary_counts_what_loads_and_lists_what_survived():
    def result(outcome, after):
        return table.Result("", "a.py", 7, "f", "a = 1", "one more", "1", after, outcome, "", 3, 0.1)

    results = [
        result("noticed", "2"),
        result("survived", "3"),
        result("not loaded", "4"),
        result("noticed", "5"),
    ]
    first, *rest = table.summary("toy", results, 2).splitlines()
    assert first == "toy: 2 of 3 noticed, 67 % (95 %: 21 to 94 %); 1 did not load, 2 equivalent"
    assert rest == ["  a.py:7 f: '1' -> '3' (one more)"]
    assert table.wilson(0, 0) == (0.0, 1.0)
