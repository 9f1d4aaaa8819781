"""Make `.venv`: the locked dependencies, then the project itself, editable.

Standard library only. The stamp `.venv/.ready` is written last and names what the environment was made of:
where interpreter, place or locks differ, or there is no stamp, the environment is made again; where only
`pyproject.toml` differs, the project is installed again. A warm call reads four files and returns.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
STAMP = VENV / ".ready"
LOCK = ROOT / "requirements.lock"
COMPILER_LOCK = ROOT / "requirements-compiler.lock"
VENV_PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


class BootstrapError(Exception):
    """The environment cannot be made; the message says what to do."""


def say(text: str) -> None:
    """Print one progress line."""
    print(f"[setup] {text}", flush=True)


def system_compiler() -> str | None:
    """Return the C compiler that the FMU will be built with, or None where there is none."""
    wanted = os.environ.get("CC", "").split()
    return shutil.which(wanted[0]) if wanted else shutil.which("cc")


def lock_files() -> list[Path]:
    """Return the locks to install: the compiler from its wheel only where the system has none."""
    return [LOCK] if system_compiler() else [LOCK, COMPILER_LOCK]


def interpreter() -> str:
    """Return which Python the environment is made with."""
    return f"python {sys.version.split()[0]} of {sys.base_prefix}\n"


def content(locks: list[Path]) -> str:
    """Return what is installed and where."""
    digest = hashlib.sha256()
    for path in locks:
        digest.update(path.read_bytes())
    return f"at {VENV}\nlocks {digest.hexdigest()}\n"


def project() -> str:
    """Return what the installed project is made of: its metadata, entry points among them."""
    return f"project {hashlib.sha256((ROOT / 'pyproject.toml').read_bytes()).hexdigest()}\n"


def wanted_start(stamped: str, locks: list[Path]) -> str:
    """Return how the stamp must start; an interpreter that nobody asked for by name may stay as it is."""
    made_with = stamped[: stamped.find("\n") + 1]
    return (interpreter() if os.environ.get("PYTHON") or not made_with else made_with) + content(locks)


def run(arguments: list[str], failure: str) -> None:
    """Run a command quietly; where it fails, raise with the end of its output."""
    environment = {**os.environ, "PIP_DISABLE_PIP_VERSION_CHECK": "1", "PIP_NO_INPUT": "1"}
    environment.pop("PYTHONPATH", None)
    done = subprocess.run(
        arguments,
        cwd=ROOT,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    if done.returncode != 0:
        tail = "\n".join("    " + line for line in done.stdout.strip().splitlines()[-12:])
        raise BootstrapError(f"{failure}\n{tail}")


def pip_of_environment() -> list[str]:
    """Return the pip command that installs into the environment: its own, else the one outside (pip 22.3).

    Debian ships `venv` without `ensurepip` unless python3-venv is installed.
    """
    inside = [str(VENV_PYTHON), "-m", "pip"]
    outside = [sys.executable, "-m", "pip", "--python", str(VENV_PYTHON)]
    for pip in (inside, outside):
        tried = subprocess.run(
            [*pip, "--version"], stdin=subprocess.DEVNULL, capture_output=True, check=False
        )
        if tried.returncode == 0:
            return pip
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    raise BootstrapError(
        f"{sys.executable} has neither ensurepip nor pip 22.3 or later, so nothing can be installed.\n"
        f"    On Debian or Ubuntu:  sudo apt install python3-venv   (or python{version}-venv)"
    )


def make_environment() -> list[str]:
    """Make an empty environment and return the pip command that installs into it."""
    venv = [sys.executable, "-m", "venv", str(VENV)]
    try:
        run(venv, "python -m venv failed:")
    except BootstrapError:
        shutil.rmtree(VENV, ignore_errors=True)  # Debian leaves half of it behind
        run([*venv, "--without-pip"], "python -m venv cannot make an environment:")
    return pip_of_environment()


def install_dependencies(pip: list[str], locks: list[Path]) -> None:
    """Install the locks: hashes required, wheels only."""
    listed = [argument for lock in locks for argument in ("-r", str(lock))]
    say("installing the locked dependencies (about 340 MB to fetch when nothing is cached) ...")
    run(
        [*pip, "install", "--quiet", "--require-hashes", "--only-binary", ":all:", "--no-deps", *listed],
        "the locked dependencies cannot be installed (no network, or a package index without them?):",
    )


def install_project(pip: list[str]) -> None:
    """Install the project, editable, with the locked build back end and without the network."""
    say("installing the project itself, editable ...")
    run(
        [
            *pip,
            "install",
            "--quiet",
            "--no-deps",
            "--no-index",
            "--no-build-isolation",
            "--editable",
            str(ROOT),
        ],
        "the project itself cannot be installed:",
    )


def make(locks: list[Path], stamped: str) -> None:
    """Bring the environment from what the stamp says to what is wanted; the stamp comes last."""
    if VENV.is_symlink() or (VENV.exists() and not VENV.is_dir()):
        raise BootstrapError(f"{VENV} is not a folder of ours; move it away.")
    wanted = wanted_start(stamped, locks)
    if stamped.startswith(wanted) and VENV_PYTHON.exists():
        STAMP.unlink()
        pip = pip_of_environment()
    else:
        wanted = interpreter() + content(locks)
        say(f"making .venv with Python {sys.version.split()[0]} ({sys.executable})")
        if COMPILER_LOCK in locks:
            say("no C compiler here: the FMU will be built with the one in the ziglang wheel")
        if VENV.exists():
            shutil.rmtree(VENV)
        pip = make_environment()
        install_dependencies(pip, locks)
    install_project(pip)
    STAMP.write_text(wanted + project())


def main() -> int:
    """Make the environment unless it is there; return the exit code."""
    locks = lock_files()
    stamped = STAMP.read_text() if STAMP.is_file() else ""
    if stamped == wanted_start(stamped, locks) + project() and VENV_PYTHON.exists():
        return 0
    started = time.monotonic()
    try:
        make(locks, stamped)
    except BaseException as error:
        if VENV.is_dir() and not VENV.is_symlink():
            shutil.rmtree(VENV, ignore_errors=True)
        if isinstance(error, (BootstrapError, OSError)):
            print(f"[setup] failed: {error}", file=sys.stderr)
            return 1
        if isinstance(error, KeyboardInterrupt):
            print("[setup] stopped; the half-made .venv is removed", file=sys.stderr)
            return 130
        raise
    say(f"ready in {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
