"""One command in front of one obstacle, as its user starts it, and what is wrong with its end."""

from __future__ import annotations

import os
import resource
import shutil
import stat
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from drivers.cache_folder import CACHE_FOLDER
from tools.impatience.child import HIL, Outcome, perform
from tools.impatience.judge import found_wrong
from tools.obstacles.commands import COMMANDS, Command
from tools.obstacles.obstacles import OBSTACLES, Obstacle, Place
from tools.obstacles.unprivileged import drop_capabilities

REFUSED_S = 15.0
"""A refusal takes no longer: it comes before anything is compiled, searched or run."""
_MOUNT = 'mount -t tmpfs -o size="$0" none runs && exec "$@"'
_REFUSED = 2
_ALLOWED = frozenset({0, 1, _REFUSED})


class Met(NamedTuple):
    """What became of a command at an obstacle."""

    command: str
    obstacle: str
    outcome: Outcome
    wrong: list[str]

    @property
    def said(self) -> list[str]:
        """What the command says of it: the lines that begin with `hil:`."""
        return [line.strip() for line in self.outcome.err.splitlines() if line.startswith("hil:")]


class Scene:
    """A scratch folder with a log, and the kernels where the commands look for them.

    Mutable state: the folder; each case has one of its own in it.
    """

    def __init__(self, scratch: Path) -> None:
        self._scratch = scratch
        self._temporary = scratch / "tmp"
        self._temporary.mkdir()
        _linked(CACHE_FOLDER, self._temporary / f"hexapod-hil-{os.getuid()}")
        self._stock = scratch / "stock.mcap"
        made = perform((*HIL, "sim", "--duration", "0.3", "--log", str(self._stock)), scratch)
        if made.code:
            raise RuntimeError(f"no log to work on: {made.err}")

    def meet(self, command: str, obstacle: str) -> Met:
        """Let a command meet an obstacle. Raises OSError where it cannot be put there."""
        case, way = COMMANDS[command], OBSTACLES[obstacle]
        folder = self._scratch / f"{command}-{obstacle}"
        place = Place(folder / "work", folder / "home", folder / "cache")
        self._furnish(place, whole=way.environment.get("XDG_CACHE_HOME", "") == "")
        way.put(place)
        if way.disk_bytes:
            (place.work / "runs").mkdir()
        outcome = self._perform(case, way, place)
        _open_again(folder)
        return Met(command, obstacle, outcome, found(outcome, place.work, way))

    def _furnish(self, place: Place, *, whole: bool) -> None:
        for each in (place.work, place.home, place.cache):
            each.mkdir(parents=True)
        if whole:
            _linked(CACHE_FOLDER, place.cache / "hexapod-hil")
        (place.work / "my.yaml").write_text((files("configs") / "virtual.yaml").read_text())
        (place.work / "stock.mcap").hardlink_to(self._stock)
        (self._scratch / "run").mkdir(mode=0o700, exist_ok=True)

    def _perform(self, case: Command, way: Obstacle, place: Place) -> Outcome:
        words = (*HIL, *case.words)
        if way.disk_bytes:
            words = ("unshare", "--map-root-user", "--mount", "sh", "-c", _MOUNT, str(way.disk_bytes), *words)
        environment: dict[str, str | None] = {
            "HOME": str(place.home),
            "XDG_CACHE_HOME": str(place.cache),
            "XDG_RUNTIME_DIR": str(self._scratch / "run"),
            "TMPDIR": str(self._temporary),
            "MPLCONFIGDIR": None,
        }
        for name, value in way.environment.items():
            environment[name] = value and value.format(home=place.home, cache=place.cache)

        def restrict() -> None:
            os.chdir(place.work)
            if not way.disk_bytes:
                drop_capabilities()
            for limit, value in way.limits.items():
                resource.setrlimit(limit, (value, value))

        moments = () if case.interrupt_s is None else (case.interrupt_s,)
        return perform(words, place.work.parent, moments, environment, preexec_fn=restrict)


def found(outcome: Outcome, work: Path, way: Obstacle) -> list[str]:
    """Return what is wrong with the end of a command in front of an obstacle; nothing for a good one."""
    wrong = found_wrong(outcome, work, _ALLOWED)
    lines = outcome.err.strip().splitlines()
    if outcome.code and not any(line.startswith("hil:") for line in lines):
        wrong.append("does not say why")
    if outcome.code == _REFUSED:
        if len(lines) != 1:
            wrong.append(f"refuses in {len(lines)} lines, not in one")
        if outcome.wall_s > REFUSED_S:
            wrong.append(f"refuses after {outcome.wall_s:.0f} s")
    if way is OBSTACLES["none"] and outcome.code:
        wrong.append("does not even work with nothing in the way")
    return wrong


def _linked(source: Path, target: Path) -> None:
    """Copy a folder by hard links where the disk allows it: nobody writes into these files."""

    def copy(old: str, new: str) -> None:
        try:
            os.link(old, new)
        except OSError:
            shutil.copy2(old, new)

    shutil.copytree(source, target, copy_function=copy, ignore=shutil.ignore_patterns("tmp*"))
    target.chmod(stat.S_IRWXU)


def _open_again(folder: Path) -> None:
    """Give back the rights that obstacles took, so that the folder can be read and removed."""
    folder.chmod(stat.S_IRWXU)
    for each in folder.iterdir():
        if each.is_dir() and not each.is_symlink():
            _open_again(each)
