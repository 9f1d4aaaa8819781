"""The obstacles: one row each, with what it puts in the way and what may come of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

FOREIGN = 65534
"""Another user: nobody."""


class Place(NamedTuple):
    """Where a command meets an obstacle; each folder is of this case alone."""

    work: Path
    """The working folder: the configuration my.yaml and the log stock.mcap are in it."""
    home: Path
    cache: Path
    """What XDG_CACHE_HOME names; hexapod-hil in it has all kernels."""


class Obstacle(NamedTuple):
    """One thing in the way."""

    text: str
    """What it is, for the table."""
    put: Callable[[Place], None] = lambda _: None
    """Puts it there."""
    environment: dict[str, str | None] = {}
    """Variables to set, or with None to take away; {home} and {cache} are the folders."""
    limits: dict[int, int] = {}
    """Resource limit -> value."""
    disk_bytes: int = 0
    """Size of a disk of its own on which `runs` is; 0 without one."""
    root_only: bool = False
    """Only root can put it there."""


def _locked(path: Path) -> None:
    path.mkdir(exist_ok=True)
    path.chmod(0o555)


def _runs_foreign(place: Place) -> None:
    runs = place.work / "runs"
    runs.mkdir(mode=0o700)
    os.chown(runs, FOREIGN, FOREIGN)


def _cache_foreign(place: Place) -> None:
    os.chown(place.cache / "hexapod-hil", FOREIGN, FOREIGN)


def _runs_file(place: Place) -> None:
    (place.work / "runs").write_text("mine\n")


def _link_to_folder(place: Place) -> None:
    (place.home / "logs").mkdir()
    (place.work / "runs").symlink_to(place.home / "logs")


_NO_CACHE: dict[str, str | None] = {"XDG_CACHE_HOME": None}

OBSTACLES = {
    "none": Obstacle("nothing in the way"),
    "folder_locked": Obstacle("working folder without the right to write", lambda p: _locked(p.work)),
    "runs_locked": Obstacle("`runs` without the right to write", lambda p: _locked(p.work / "runs")),
    "runs_foreign": Obstacle("`runs` of another user, mode 0700", _runs_foreign, root_only=True),
    "runs_file": Obstacle("`runs` is a file", _runs_file),
    "runs_link": Obstacle("`runs` is a link to a folder", _link_to_folder),
    "runs_nowhere": Obstacle(
        "`runs` is a link to nothing", lambda p: (p.work / "runs").symlink_to(p.home / "locked" / "none")
    ),
    "home_unset": Obstacle("HOME unset", environment={"HOME": None, **_NO_CACHE}),
    "home_missing": Obstacle(
        "HOME names a folder that is not there and cannot be made",
        lambda p: _locked(p.home / "locked"),
        {"HOME": "{home}/locked/none", **_NO_CACHE},
    ),
    "home_locked": Obstacle("no right to enter HOME", lambda p: p.home.chmod(0), _NO_CACHE),
    "cache_locked": Obstacle(
        "XDG_CACHE_HOME without the right to write",
        lambda p: _locked(p.home / "cache"),
        {"XDG_CACHE_HOME": "{home}/cache"},
    ),
    "cache_open": Obstacle("cache of mode 0777", lambda p: (p.cache / "hexapod-hil").chmod(0o777)),
    "cache_foreign": Obstacle("cache of another user", _cache_foreign, root_only=True),
    "disk_full": Obstacle("`runs` on a disk with 200 kB left", disk_bytes=200_000),
    "disk_none": Obstacle("`runs` on a disk with 4 kB left", disk_bytes=4096),
}
"""Name -> obstacle."""
