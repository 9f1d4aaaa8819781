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


class BootstrapError(Exception):
    """The environment cannot be created; the message says what to do."""


def say(text: str) -> None:
    """Print one line of progress."""
    print(f"[setup] {text}", flush=True)


def system_compiler() -> str | None:
    """Path of the C compiler that can build the FMU, from $CC or `cc`; None without a compiler."""
    wanted = os.environ.get("CC", "").split()
    return shutil.which(wanted[0]) if wanted else shutil.which("cc")


def lock_files() -> list[Path]:
    """Lock files to install; that of the compiler only if the system has no compiler."""
    return [LOCK] if system_compiler() else [LOCK, COMPILER_LOCK]


def interpreter() -> str:
    """Line of the stamp file `.venv/.ready` that identifies the Python interpreter."""
    return f"python {sys.version.split()[0]} of {sys.base_prefix}\n"


def content(locks: list[Path]) -> str:
    """Lines of the stamp file that identify the folder of the environment and the locked dependencies."""
    digest = hashlib.sha256()
    for path in locks:
        digest.update(path.read_bytes())
    return f"at {VENV}\nlocks {digest.hexdigest()}\n"


def project() -> str:
    """Line of the stamp file that identifies the installed project: a hash of `pyproject.toml`."""
    return f"project {hashlib.sha256((ROOT / 'pyproject.toml').read_bytes()).hexdigest()}\n"


def wanted_start(stamped: str, locks: list[Path]) -> str:
    """Beginning that the stamp must have; the interpreter may differ unless $PYTHON selects one."""
    made_with = stamped[: stamped.find("\n") + 1]
    return (interpreter() if os.environ.get("PYTHON") or not made_with else made_with) + content(locks)


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


def pip_of_environment() -> list[str]:
    """Command of a pip that installs into the environment: its own, else one outside (pip 22.3).

    Debian has `venv` without `ensurepip` unless python3-venv is installed.
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
    """Create an empty environment; return the pip command that installs into it."""
    venv = [sys.executable, "-m", "venv", str(VENV)]
    try:
        run(venv, "python -m venv failed:")
    except BootstrapError:
        shutil.rmtree(VENV, ignore_errors=True)  # Debian leaves half of it behind
        run([*venv, "--without-pip"], "python -m venv cannot make an environment:")
    return pip_of_environment()


def install_dependencies(pip: list[str], locks: list[Path]) -> None:
    """Install the locked dependencies: hashes required, wheels only."""
    listed = [argument for lock in locks for argument in ("-r", str(lock))]
    say("installing the locked dependencies (about 340 MB to download if nothing is cached) ...")
    run(
        [*pip, "install", "--quiet", "--require-hashes", "--only-binary", ":all:", "--no-deps", *listed],
        "the locked dependencies cannot be installed (no network, or a package index without them?):",
    )


def install_project(pip: list[str]) -> None:
    """Install the project, editable, with the locked build back end and without network."""
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
    """Create or update `.venv`, starting from the state in `stamped`; write the stamp file last."""
    if VENV.is_symlink() or (VENV.exists() and not VENV.is_dir()):
        raise BootstrapError(f"{VENV} is not a folder; move it away.")
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
    """Create the environment unless it is up to date; return the exit code."""
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
            print("[setup] stopped; the incomplete .venv is removed", file=sys.stderr)
            return 130
        raise
    say(f"ready in {time.monotonic() - started:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
