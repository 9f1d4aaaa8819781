"""A runtime folder for each test of a bus, and participants on its localcan channel `t`."""

import shutil
import tempfile
from pathlib import Path

import pytest

from drivers.can.localcan.participant import DEFAULT_TIMING, Participant


@pytest.fixture
def runtime(monkeypatch):
    # not tmp_path: a socket's path has to be shorter than 108 characters
    folder = tempfile.mkdtemp(prefix="lc")
    monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
    yield Path(folder)
    shutil.rmtree(folder)


@pytest.fixture
def join(runtime):
    nodes: list[Participant] = []

    def open_node(timing=DEFAULT_TIMING, fd=True, **options):
        nodes.append(Participant("t", timing, fd=fd, **options))
        return nodes[-1]

    yield open_node
    for node in nodes:
        node.close()
