"""The first compilation counts: kernels of what a program imports, one after the other, and the time left."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from drivers.compiled import cache, progress
from drivers.compiled.progress import Compilation, Progress, to_compile
from hil.app.compiling import Display, line

KERNEL = "@kernel(REAL)\ndef {}(x):\n    return x\n\n\n"
FILES = {
    "program.py": "import project_p.first\n\n\ndef late():\n    from project_p import second\n",
    "first.py": "def unused():\n    import project_p.third\n\n\n" + KERNEL.format("a") + KERNEL.format("b"),
    "second.py": KERNEL.format("c"),
    "third.py": KERNEL.format("d"),
    "__init__.py": "",
}


@pytest.fixture
def project(monkeypatch, tmp_path):
    """A program that imports two files with kernels; one of them imports a third in a function."""
    folder = tmp_path / "project_p"
    folder.mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)

    def file_of(module):
        path = tmp_path.joinpath(*module.split("."))
        found = [path.with_suffix(".py"), path / "__init__.py"]
        return next((each for each in found if each.is_file()), None)

    pattern = cache._IMPORT.pattern.replace("hil", "project_p")
    monkeypatch.setattr(cache, "_IMPORT", re.compile(pattern, re.MULTILINE))
    monkeypatch.setattr(cache, "file_of", file_of)
    monkeypatch.setattr(cache, "CACHE_FOLDER", tmp_path / "cache")
    for remembered in (cache.imports, cache.sources_of, cache._content, cache.folder_of):
        remembered.cache_clear()
    return folder


def counts(project: Path) -> dict[str, int]:
    return {source.name: count for source, count in to_compile([project / "program.py"]).items()}


def test_what_is_to_come_is_what_the_program_imports_anywhere_and_its_imports_as_modules(project):
    assert counts(project) == {"first.py": 2, "second.py": 1}


def test_what_the_cache_has_is_not_to_come(project):
    kept = cache.folder_of(project / "first.py")
    kept.mkdir(parents=True)
    (kept / "a-1.py311.nbi").touch()
    assert counts(project) == {"first.py": 1, "second.py": 1}
    for name in ("b", "c"):
        (kept / f"{name}-1.py311.nbi").touch()
    assert counts(project) == {"first.py": 0, "second.py": 1}, "not less than none"


def test_a_kernel_that_is_compiled_before_anything_was_told_begins_the_count(project):
    told: list[Progress] = []
    Compilation([project / "program.py"], told.append).compiled(project / "first.py")
    assert [(at.done, at.total) for at in told] == [(0, 3), (1, 3)]


def test_a_kernel_costs_its_share_of_the_source_and_a_least_one(tmp_path):
    source = tmp_path / "a.py"
    for kernels, work in ((0, 5000.0), (1, 5000.0), (2, 3500.0), (3, 3000.0)):
        text = "@kernel(\n" * kernels
        source.write_text(text + "x" * (3000 - len(text)))
        assert progress._work(source) == work


def test_each_kernel_counts_and_more_than_was_known_lets_the_total_grow(project):
    told: list[Progress] = []
    compilation = Compilation([project / "program.py"], told.append)
    compilation.begin()
    compilation.begin()
    for name in ("first.py", "first.py", "third.py", "second.py"):
        compilation.compiled(project / name)
    assert [(at.done, at.total) for at in told] == [(0, 3), (1, 3), (2, 3), (3, 4), (4, 4)]
    assert math.isnan(told[0].left_s)
    assert told[-1].left_s == 0.0


def test_the_time_left_follows_from_the_pace(project, monkeypatch):
    told: list[Progress] = []
    begun = 7_000_000_000
    now = iter([begun, begun, begun + 4_000_000_000])
    monkeypatch.setattr("time.monotonic_ns", lambda: next(now))
    monkeypatch.setattr(progress, "_work", lambda source: {"first": 2.0, "second": 5.0}[source.stem])
    compilation = Compilation([project / "program.py"], told.append)
    compilation.begin()
    compilation.compiled(project / "first.py")
    assert (told[-1].elapsed_s, told[-1].left_s) == (4.0, 14.0)  # work of 2 in 4 s, of 2 and 5 to come


@pytest.mark.parametrize(("terminal", "lines"), [(False, 3), (True, 5)])
def test_a_pipe_gets_a_line_now_and_then_and_a_terminal_each_kernel(terminal, lines, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal, raising=False)
    monkeypatch.setattr("hil.app.compiling.elsewhere", lambda: "")
    display = Display()
    for done, elapsed_s in ((0, 0.0), (1, 9.0), (2, 10.0), (3, 19.0), (4, 21.0)):
        display.show(Progress(done, 4, elapsed_s, float(4 - done)))
    said = capsys.readouterr().err
    assert said.count("\r" if terminal else "\n") == lines
    assert said.endswith("\r\x1b[K" if terminal else f"{line(Progress(4, 4, 21.0, 0.0))}\n")


def test_the_line_says_which_of_how_many_and_how_long():
    assert line(Progress(3, 79, 10.0, 61.4)) == (
        "compiling the mathematics, once: 3 of 79 kernels, about 61 s left; Ctrl-C loses little of it ..."
    )


def test_on_a_terminal_of_usual_width_the_line_stays_in_one_row_that_the_next_one_rewrites(
    capsys, monkeypatch
):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr("hil.app.compiling.elsewhere", lambda: "")
    Display().show(Progress(3, 79, 10.0, 61.4))
    said = capsys.readouterr().err
    assert said == "\r\x1b[Kcompiling the mathematics, once: 3 of 79 kernels, about 61 s left; Ctrl-C loses"
