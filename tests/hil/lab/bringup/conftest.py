"""A separate runtime folder for each test that opens sockets."""

import tempfile
from collections.abc import Iterator

import pytest


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A short path, since that of a socket has at most 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        yield name
