"""What is shown while a first start compiles: which kernel of how many."""

import re

import pytest

from drivers.compiled import cache
from hil.app import compiling
from hil.app.compiling import show_compilation


@pytest.fixture
def show(monkeypatch):
    """Let a kernel be compiled that takes so many seconds."""
    now = [0.0]
    monkeypatch.setattr(cache, "_watching", [])
    monkeypatch.setattr(compiling, "elsewhere", lambda: "")
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    show_compilation()

    def compiled(seconds):
        cache.tell(compiling=True)
        now[0] += seconds
        cache.tell(compiling=False)

    return compiled


def test_nothing_is_shown_where_nothing_is_compiled(show, capsys):
    assert capsys.readouterr().err == ""


def test_a_pipe_gets_a_line_now_and_then(show, capsys):
    for seconds in (9.0, 2.0, 8.0, 2.0, 1.0):
        show(seconds)
    lines = capsys.readouterr().err.splitlines()
    assert [int(number) for line in lines for number in re.findall(r"kernel (\d+) of", line)] == [1, 3, 5]


def test_a_terminal_gets_a_row_a_kernel_that_goes_with_it(show, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    for _ in range(3):
        show(1.0)
    shown = capsys.readouterr().err
    assert re.findall(r"kernel (\d+) of", shown) == ["1", "2", "3"]
    assert shown.endswith("\r\x1b[K")
    assert "\n" not in shown


def test_how_many_there_are_at_most_is_counted_in_the_sources(show, capsys):
    show(1.0)
    (most,) = map(int, re.findall(r"of at most (\d+)", capsys.readouterr().err))
    assert 100 < most < 300


def test_where_the_cache_lies_elsewhere_is_said_once(show, capsys, monkeypatch):
    monkeypatch.setattr(compiling, "elsewhere", lambda: "no room: what is compiled goes to /tmp")
    show(1.0)
    show(20.0)
    assert capsys.readouterr().err.count("goes to /tmp") == 1
