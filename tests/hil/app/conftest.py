"""Fixtures of this room: servers of `hil watch`, and a `hil check` without proofs."""

from __future__ import annotations

import tempfile

import pytest

from tests.live_run import Watch, operating


@pytest.fixture
def unproven(monkeypatch):
    """Let `hil check` leave out what takes most of its time: what is proven of the law, and this process's rights."""
    monkeypatch.setattr("hil.app.check.controller._stability", lambda *_: None)
    monkeypatch.setattr("hil.app.check.command._permissions", lambda *_: None)


@pytest.fixture(scope="module")
def meeting_place():
    """A folder for sockets and mirrors of its own: a socket's path is short."""
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
