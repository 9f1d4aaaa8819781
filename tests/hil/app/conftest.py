"""Fixtures of the command tests: servers of `hil watch`, and a `hil check` without proofs."""

from __future__ import annotations

import tempfile

import pytest

from hil.app.check import command, figures
from tests.live_run import Watch, operating


@pytest.fixture
def unproven(monkeypatch):
    """Skip the slow parts of `hil check`: the stability proof and the real-time rights of this process."""
    slow = (figures.stability, figures.permissions)
    monkeypatch.setattr(command, "SECTIONS", tuple(each for each in command.SECTIONS if each not in slow))


@pytest.fixture(scope="module")
def meeting_place():
    """A private folder for sockets and mirrors, with a short path as sockets need."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield


@pytest.fixture(scope="module")
def watch(meeting_place):
    with Watch("virtual") as watching:
        yield watching


@pytest.fixture(scope="module")
def operated(meeting_place, tmp_path_factory):
    with Watch(operating(tmp_path_factory.mktemp("operated"))) as watching:
        yield watching
