"""The Debian packages of the user-mode kernel, unpacked into a cache folder of this user.

No package is installed and no system folder is written. apt downloads the packages and checks their
signatures; dpkg-deb unpacks them.
"""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

PACKAGES = ("user-mode-linux", "busybox-static", "can-utils")
FETCH_LIMIT_S = 90.0


class UnavailableError(Exception):
    """This machine cannot provide a kernel with CAN; the message gives the reason."""


def cache_folder() -> Path:
    """Folder that keeps the unpacked packages between runs."""
    given = os.environ.get("XDG_CACHE_HOME")
    root = Path(given) if given else Path.home() / ".cache"
    return root / "hexapod-hil" / "user-mode-linux"


def unpacked() -> Path:
    """Root of the unpacked packages; they are downloaded if missing.

    Raises
    ------
    UnavailableError
        Debian tools are missing, another architecture, or the download fails.
    """
    if platform.machine() != "x86_64":
        raise UnavailableError(
            f"user-mode Linux is packaged for x86-64, this machine is {platform.machine()}"
        )
    missing = [tool for tool in ("apt-get", "dpkg-deb") if shutil.which(tool) is None]
    if missing:
        raise UnavailableError(
            f"no {' and no '.join(missing)}: user-mode Linux is fetched as a Debian package"
        )
    cache = cache_folder()
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with (cache / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            root = cache / "root"
            if not root.is_dir():
                _unpack_into(root, cache)
            return root
    except OSError as error:
        raise UnavailableError(f"cache folder {cache}: {error}") from error


def _unpack_into(root: Path, cache: Path) -> None:
    """Download and unpack next to `root`, then rename: an existing `root` is complete."""
    with tempfile.TemporaryDirectory(dir=cache) as temporary:
        work = Path(temporary)
        lists = work / "lists"
        (lists / "partial").mkdir(parents=True)
        archives = work / "archives"
        (archives / "partial").mkdir(parents=True)
        own_state = [f"Dir::State::lists={lists}", f"Dir::Cache={archives}"]
        try:
            _apt(work, [], "download", *PACKAGES)
        except UnavailableError:  # a fresh container has no package lists: use lists of our own
            _apt(work, own_state, "update")
            _apt(work, own_state, "download", *PACKAGES)
        new = work / "root"
        for package in sorted(work.glob("*.deb")):
            subprocess.run(["dpkg-deb", "-x", package, new], check=True, timeout=FETCH_LIMIT_S)
        new.rename(root)


def _apt(work: Path, options: list[str], *arguments: str) -> None:
    flags = [flag for option in ("APT::Sandbox::User=", *options) for flag in ("-o", option)]
    command = ["apt-get", "-q", "-y", *flags, *arguments]
    try:
        done = subprocess.run(
            command,
            cwd=work,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=FETCH_LIMIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise UnavailableError(f"apt-get {arguments[0]} took longer than {FETCH_LIMIT_S:.0f} s") from error
    if done.returncode != 0:
        reason = "; ".join(done.stderr.strip().splitlines()[-3:]) or f"exit code {done.returncode}"
        raise UnavailableError(f"apt-get {' '.join(arguments)}: {reason}")
