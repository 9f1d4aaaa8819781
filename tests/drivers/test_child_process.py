"""A child process of ours: what it finds, and what it must not."""

import subprocess
from pathlib import Path

import drivers
from drivers.child_process import start

PROGRAM = """
import os, sys
import drivers
print(drivers.__file__, sys.argv[1:], os.environ["COLOUR"], os.environ["SHAPE"], sep="|")
"""


def test_a_child_finds_our_packages_and_the_users_path_but_nothing_in_the_working_directory(
    tmp_path, monkeypatch
):
    library = tmp_path / "library"
    library.mkdir()
    (library / "program.py").write_text(PROGRAM)
    (tmp_path / "drivers.py").write_text("raise SystemExit('the wrong drivers')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(library))
    monkeypatch.setenv("SHAPE", "round")
    monkeypatch.setenv("COLOUR", "blue")
    child = start("program", "a", "b c", environment={"COLOUR": "red"}, stdout=subprocess.PIPE)
    answer, _ = child.communicate(timeout=60)
    found, *rest = answer.decode().strip().split("|")
    assert Path(found) == Path(drivers.__file__)
    assert rest == ["['a', 'b c']", "red", "round"]
