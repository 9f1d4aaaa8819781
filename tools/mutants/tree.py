"""A copy of the project, in which one file at a time is changed and the tests that may notice run."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from drivers.cache_folder import CACHE_FOLDER
from tools.mutants.areas import ROOT

QUICK = "not long and not realtime and not vcan"
"""Tests that need neither the machine for themselves nor a kernel."""
_LOADED, _FAILED = 0, 1


class Tree:
    """A copy of the tree and of the cache of kernels, in a folder of its own.

    What a mutant compiles goes to the copy of the cache, and is removed with the mutant.
    """

    def __init__(self, folder: Path, source: Path = ROOT) -> None:
        self.root, self.cache = folder / "tree", folder / "cache" / CACHE_FOLDER.name
        shutil.rmtree(folder, ignore_errors=True)
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listed, cwd=source, check=True, capture_output=True, text=True).stdout
        for name in filter(None, names.split("\0")):
            if (source / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source / name, self.root / name)
        shutil.copytree(CACHE_FOLDER, self.cache, copy_function=_link)

    @contextlib.contextmanager
    def changed(self, file: str, text: str) -> Iterator[None]:
        """Have one file changed, and nothing left of it afterwards."""
        path = self.root / file
        before, compiled = path.read_bytes(), set(self.cache.iterdir())
        path.write_text(text, encoding="utf-8")
        self._forget(path)
        try:
            yield
        finally:
            path.write_bytes(before)
            self._forget(path)
            for folder in set(self.cache.iterdir()) - compiled:
                if folder.is_dir():
                    shutil.rmtree(folder)
                else:
                    folder.unlink()

    def _forget(self, path: Path) -> None:
        """Remove the bytecode: its stamp is the second and the size, which two mutants can share."""
        for bytecode in path.parent.joinpath("__pycache__").glob(f"{path.stem}.*.pyc"):
            bytecode.unlink()

    def loads(self, file: str, limit_s: float) -> bool:
        """Tell whether the module can be imported."""
        name = file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        return self._run([sys.executable, "-c", f"import {name}"], {}, limit_s) == _LOADED

    def record(self, files: list[str], out: Path, limit_s: float = 3600.0) -> None:
        """Record what the tests of some files run."""
        plugin = ["-p", "tools.mutants.contexts"]
        self._run([*_pytest(), *plugin, *files], {"MUTANTS_CONTEXTS": str(out)}, limit_s)

    def noticed_by(self, tests: list[str], limit_s: float) -> str:
        """Run tests up to the first that fails; return it, empty where all pass.

        A run that dies, or lasts longer than `limit_s`, is noticed by the test that was on.
        """
        chosen, witness = self.root.parent / "chosen.json", self.root.parent / "witness.txt"
        chosen.write_text(json.dumps(tests), encoding="utf-8")
        witness.write_text("", encoding="utf-8")
        files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        environment = {"MUTANTS_CHOSEN": str(chosen), "MUTANTS_WITNESS": str(witness)}
        code = self._run([*_pytest(), "-x", "-p", "tools.mutants.witness", *files], environment, limit_s)
        said = [line.split(" ", 1) for line in witness.read_text(encoding="utf-8").splitlines()]
        last = said[-1][1] if said else "the collection of tests"
        if code == _LOADED:
            return ""
        if code is None:
            return f"{last} (time limit of {limit_s:.0f} s)"
        failed = next((test for what, test in said if what == "fails"), None)
        return failed or f"{last} (exit code {code})"

    def _run(self, command: list[str], more: dict[str, str], limit_s: float) -> int | None:
        """Run a command in the copy; return its exit code, None where it took too long and was ended."""
        environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        environment |= {"PYTHONPATH": str(self.root), "XDG_CACHE_HOME": str(self.cache.parent), **more}
        with (self.root.parent / "output.txt").open("w", encoding="utf-8") as output:
            process = subprocess.Popen(
                command,
                cwd=self.root,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            until = time.monotonic() + limit_s
            try:
                return process.wait(max(until - time.monotonic(), 0.0))
            except subprocess.TimeoutExpired:
                return None
            finally:  # what a test started goes with it
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _pytest() -> list[str]:
    return [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", "-m", QUICK]


def _link(source: str, target: str) -> str:
    """Link a file of the cache, whose writers replace files and never change one; copy across devices."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
    return target
