"""A plugin of pytest that records which functions and lines of the project each test runs.

It writes a JSON line a test to the file that `MUTANTS_CONTEXTS` names, and one a test file for what its
shared fixtures run. Python 3.11 has no `sys.monitoring`, so a trace function sees each call; it follows the
lines of a function in its first calls only, so that a run of thousands of ticks stays affordable.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Generator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

PACKAGES = ("hil/", "drivers/", "plant_fmu/")
FOLLOWED_CALLS = 40
"""Calls of a function, in one test, whose lines are followed."""


class Seen:
    """What ran: the calls of each code object, the lines of each file."""

    def __init__(self) -> None:
        self.calls: Counter[CodeType] = Counter()
        self.lines: dict[str, set[int]] = {}


class Recorder:
    """The plugin: it owns the trace function and the open file."""

    def __init__(self, root: Path, out: Path) -> None:
        self.root, self.out = root, out.open("w", encoding="utf-8")
        self.names: dict[CodeType, tuple[str, str] | None] = {}
        self.now = Seen()
        self.shared: dict[str, Seen] = {}
        self.failed: set[str] = set()

    def name(self, code: CodeType) -> tuple[str, str] | None:
        """Return file and qualified name, as `mutant.Mutant` has them; None outside the project."""
        if code not in self.names:
            path = Path(code.co_filename)
            file = path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else ""
            parts = [part for part in code.co_qualname.split(".") if not part.startswith("<")]
            self.names[code] = (file, ".".join(parts)) if file.startswith(PACKAGES) else None
        return self.names[code]

    def trace(self, frame: FrameType, _event: str, _arg: object) -> Callable[..., Any] | None:
        """Count a call; return what follows its lines, in the first calls."""
        code = frame.f_code
        name = self.names[code] if code in self.names else self.name(code)
        if name is None:
            return None
        calls = self.now.calls
        calls[code] += 1
        if calls[code] > FOLLOWED_CALLS:
            return None
        lines = self.now.lines.setdefault(name[0], set())

        def follow(frame: FrameType, event: str, _arg: object) -> Callable[..., Any]:
            if event == "line":
                lines.add(frame.f_lineno)
            return follow

        return follow

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Record one test."""
        self.now = Seen()
        begun = time.perf_counter()
        sys.settrace(self.trace)
        threading.settrace(self.trace)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)
            seconds = time.perf_counter() - begun
            passed = item.nodeid not in self.failed
            self.write(self.now, test=item.nodeid, seconds=round(seconds, 3), passed=passed)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Generator[None, object, object]:
        """Record what a fixture of more than one test runs for all tests of the file."""
        mine = self.now
        if fixturedef.scope != "function":
            self.now = self.shared.setdefault(request.node.nodeid.partition("::")[0], Seen())
        try:
            return (yield)
        finally:
            self.now = mine

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note what does not pass."""
        if report.outcome != "passed":
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        """Write what the files' fixtures ran."""
        for file, seen in self.shared.items():
            self.write(seen, file=file)
        self.out.close()

    def write(self, seen: Seen, **facts: object) -> None:
        """Write one line; the lines of a file are the bits of a number."""
        functions: dict[str, list[str]] = {}
        for code in seen.calls:
            name = self.names[code]
            assert name is not None
            functions.setdefault(name[0], []).append(name[1])
        lines = {file: hex(sum(1 << line for line in found)) for file, found in seen.lines.items()}
        print(json.dumps({**facts, "functions": functions, "lines": lines}), file=self.out, flush=True)


def pytest_configure(config: pytest.Config) -> None:
    """Register the recorder."""
    config.pluginmanager.register(Recorder(config.rootpath, Path(os.environ["MUTANTS_CONTEXTS"])))
