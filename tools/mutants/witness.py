"""A plugin of pytest that runs chosen tests in their order, and writes at once which one is on and fails.

`MUTANTS_CHOSEN` names a JSON list of tests, `MUTANTS_WITNESS` the file it writes. So the name of a test that
hangs, or kills its process, is known, too.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest


class Witness:
    """The plugin: the order of the tests and the open file."""

    def __init__(self, chosen: Path, out: Path) -> None:
        self.order = {test: k for k, test in enumerate(json.loads(chosen.read_text(encoding="utf-8")))}
        self.out = out.open("w", encoding="utf-8")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep the chosen tests, in their order."""
        items[:] = sorted((i for i in items if i.nodeid in self.order), key=lambda i: self.order[i.nodeid])

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Write which test begins."""
        print("begins", nodeid, file=self.out, flush=True)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write which test fails."""
        if report.failed:
            print("fails", report.nodeid, file=self.out, flush=True)


def pytest_configure(config: pytest.Config) -> None:
    """Register the witness."""
    given = Path(os.environ["MUTANTS_CHOSEN"]), Path(os.environ["MUTANTS_WITNESS"])
    config.pluginmanager.register(Witness(*given))
