"""Which tests can notice a mutant, cheapest first: by lines, by functions, by users of a kernel."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import grimp

from tools.mutants.areas import ROOT
from tools.mutants.mutant import Mutant


@dataclass
class Context:
    """What one test runs: functions as (file, name), the lines of a file as bits."""

    test: str
    seconds: float
    functions: set[tuple[str, str]] = field(default_factory=set)
    lines: dict[str, int] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """The test's file."""
        return self.test.partition("::")[0]

    def add(self, entry: dict[str, dict[str, list[str]] | dict[str, str]]) -> None:
        """Add what a line of the recording says."""
        self.functions |= {(file, name) for file, names in entry["functions"].items() for name in names}
        for file, bits in entry["lines"].items():
            self.lines[file] = self.lines.get(file, 0) | int(str(bits), 16)


def contexts(recordings: Iterable[Path]) -> list[Context]:
    """Read recordings of `tools.mutants.contexts`; tests that do not pass unchanged are left out."""
    found: dict[str, Context] = {}
    shared = []
    for path in recordings:
        for line in path.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            if "file" in entry:
                shared.append(entry)
            elif entry["passed"]:
                context = found[entry["test"]] = Context(entry["test"], entry["seconds"])
                context.add(entry)
    for entry in shared:
        for context in found.values():
            if context.file == entry["file"]:
                context.add(entry)
    return list(found.values())


@functools.cache
def _graph() -> grimp.ImportGraph:
    return grimp.build_graph("drivers", "hil", "plant_fmu")


@functools.cache
def users(file: str) -> list[str]:
    """Return the project's files whose imports lead to `file`, the nearest first."""
    graph, module = _graph(), file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    if module not in graph.modules:
        return []
    found = [(len(graph.find_upstream_modules(user)), user) for user in graph.find_downstream_modules(module)]
    return [_file_of(user) for _, user in sorted(found)]


def _file_of(module: str) -> str:
    path = module.replace(".", "/")
    return f"{path}/__init__.py" if (ROOT / path).is_dir() else f"{path}.py"


def chosen(mutant: Mutant, known: list[Context], budget_s: float) -> list[Context]:
    """Return the tests that can notice a mutant, in the order to run them, of `budget_s` seconds in all.

    First the tests that run its line, then those that run its function, then those that run anything of its
    file, then those of its users, the nearest first: neither kernels nor other processes are traced.
    A file's tests stay together: they share fixtures.
    """
    ranks = [
        [c for c in known if c.lines.get(mutant.file, 0) >> mutant.line & 1],
        [c for c in known if (mutant.file, mutant.where) in c.functions],
    ]
    ranks += _running([mutant.file, *users(mutant.file)], known)
    result: list[Context] = []
    spent = 0.0
    taken: set[str] = set()
    for rank in ranks:
        for context in _cheapest_files_first([c for c in rank if c.test not in taken]):
            if not result or spent + context.seconds <= budget_s:
                result.append(context)
                spent += context.seconds
                taken.add(context.test)
    return result


def _running(files: Iterable[str], known: list[Context]) -> list[list[Context]]:
    """Return, for each file of which a test runs something, these tests."""
    found = ([c for c in known if any(f == file for f, _ in c.functions)] for file in files)
    return [tests for tests in found if tests]


def _cheapest_files_first(tests: list[Context]) -> list[Context]:
    cost: dict[str, float] = {}
    for context in tests:
        cost[context.file] = cost.get(context.file, 0.0) + context.seconds
    return sorted(tests, key=lambda c: (cost[c.file], c.file, c.seconds))
