"""Create `.venv` with the locked dependencies and the project itself, editable.

Standard library only. The stamp `.venv/.ready` is written last and lists the inputs of the environment. If
interpreter, place or locks differ, or there is no stamp, the environment is created again. If only
`pyproject.toml` differs, the project is installed again. If nothing differs, a call reads four files and
ends.
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
BASE: str = getattr(sys, "_base_executable", sys.executable)
"""Interpreter outside of an activated environment, which may be the one that is made again."""


class BootstrapError(Exception):
    """The environment cannot be created; the message says what to do."""


def say(text: str) -> None:
    """Print one line of progress."""
    print(f"[setup] {text}", flush=True)


def lock_files() -> list[Path]:
    """Lock files to install; that of the compiler only if the system has none ($CC, else `cc`)."""
    compiler = shutil.which((os.environ.get("CC", "").split() or ["cc"])[0])
    return [LOCK] if compiler else [LOCK, COMPILER_LOCK]


def state(locks: list[Path], stamped: list[str]) -> list[str]:
    """Lines of the stamp: interpreter, place and locks, project.

    The interpreter may stay the stamped one unless $PYTHON selects one.
    """
    made_with = [] if os.environ.get("PYTHON") else stamped[:1]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in locks)).hexdigest()
    project = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    python = made_with or [f"python {sys.version.split()[0]} of {sys.base_prefix}"]
    return [*python, f"at {VENV}, locks {digest}", f"project {project}"]


def run(arguments: list[str], failure: str) -> None:
    """Run a command quietly; if it fails, raise BootstrapError with the end of its output."""
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


def pip() -> list[str]:
    """Command of a pip that installs into the environment: its own, else one outside (pip 22.3)."""
    if any(VENV.glob("*/pip*")):
        return [str(VENV_PYTHON), "-m", "pip"]
    return [BASE, "-m", "pip", "--python", str(VENV_PYTHON)]


def make_environment() -> None:
    """Create an empty environment. Debian has `venv` without `ensurepip` unless python3-venv is installed."""
    venv = [BASE, "-m", "venv", str(VENV)]
    try:
        run(venv, "python -m venv failed:")
    except BootstrapError:
        shutil.rmtree(VENV, ignore_errors=True)  # Debian leaves half of it behind
        run([*venv, "--without-pip"], "python -m venv failed; on Debian or Ubuntu: apt install python3-venv")


def make(locks: list[Path], stamped: list[str], wanted: list[str]) -> None:
    """Create or update `.venv`, starting from the state `stamped`; write the stamp file last."""
    if VENV.is_symlink() or (VENV.exists() and not VENV.is_dir()):
        raise BootstrapError(f"{VENV} is not a folder; move it away.")
    if stamped[:2] == wanted[:2] and VENV_PYTHON.exists():
        STAMP.unlink()
    else:
        wanted = state(locks, [])
        say(f"making .venv with Python {sys.version.split()[0]} ({BASE})")
        if COMPILER_LOCK in locks:
            say("no C compiler here: the FMU will be built with the one in the ziglang wheel")
        if VENV.exists():
            shutil.rmtree(VENV)
        make_environment()
        say("installing the locked dependencies (about 340 MB to download if nothing is cached) ...")
        options = ["--require-hashes", "--only-binary", ":all:", "--no-deps"]
        run(
            [*pip(), "install", "--quiet", *options, *(f"--requirement={lock}" for lock in locks)],
            "the locked dependencies cannot be installed (no pip, no network, or an index without them?):",
        )
    say("installing the project itself, editable ...")
    options = ["--no-deps", "--no-index", "--no-build-isolation"]  # the locked build back end, no network
    run(
        [*pip(), "install", "--quiet", *options, "--editable", str(ROOT)],
        "the project itself cannot be installed:",
    )
    STAMP.write_text("\n".join(wanted))


def main() -> int:
    """Create the environment unless it is up to date; return the exit code."""
    locks, stamped = lock_files(), STAMP.read_text().splitlines() if STAMP.is_file() else []
    wanted = state(locks, stamped)
    if stamped == wanted and VENV_PYTHON.exists():
        return 0
    started = time.monotonic()
    try:
        make(locks, stamped, wanted)
    except BaseException as error:
        if VENV.is_dir() and not VENV.is_symlink():
            shutil.rmtree(VENV, ignore_errors=True)
        if isinstance(error, (BootstrapError, OSError)):
            print(f"[setup] failed: {error}", file=sys.stderr)
            return 1
        if isinstance(error, KeyboardInterrupt):
            print("[setup] stopped; the incomplete .venv is removed", file=sys.stderr)
            return 130
        raise
    say(f"ready in {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
