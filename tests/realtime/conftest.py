"""Fixtures of the real-time tests; processes and listeners end with their test."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.realtime.rig import Listener, Process


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """A function that starts a `hil` command."""
    with contextlib.ExitStack() as stack:

        def begin(*arguments: str, folder: Path = tmp_path, **options: Any) -> Process:
            process = Process(folder, *arguments, **options)
            stack.callback(process.clean_up)
            return process

        yield begin


@pytest.fixture
def listen() -> Iterator[Callable[[Path], Listener]]:
    """A function that listens on the bus of a configuration."""
    with contextlib.ExitStack() as stack:

        def begin(file: Path) -> Listener:
            listener = Listener(file)
            stack.callback(listener.close)
            return listener

        yield begin
