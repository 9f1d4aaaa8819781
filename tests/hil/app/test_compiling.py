"""What is shown while a first start compiles: which kernel of how many."""

import re

import pytest

from drivers.compiled import cache
from hil.app.compiling import show_compilation


@pytest.fixture
def compiled(monkeypatch):
    """Let some kernels be compiled."""
    monkeypatch.setattr(cache, "progress", cache.progress)
    show_compilation()

    def compiled(count):
        for _ in range(count):
            cache.progress(True)
            cache.progress(False)

    return compiled


def test_a_pipe_gets_one_line_and_none_where_nothing_is_compiled(compiled, capsys):
    assert capsys.readouterr().err == ""
    compiled(3)
    (line,) = capsys.readouterr().err.splitlines()
    (most,) = map(int, re.findall(r"kernel 1 of at most (\d+)", line))
    assert 100 < most < 300, "counted in the sources"
