"""A runtime folder of its own for each test that opens sockets."""

import tempfile
from collections.abc import Iterator

import pytest


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The path of a socket has 108 bytes."""
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        monkeypatch.setenv("XDG_RUNTIME_DIR", name)
        yield name
