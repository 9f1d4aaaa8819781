"""Run a command next to vcan0: in a separate network namespace, else in a user-mode Linux kernel.

``python tests/vcan/uml.py [--limit S] [--share FOLDER] [--kernel any|running|uml] -- COMMAND ...``

The running kernel is used if it has virtual CAN and permits a network namespace, so no interface of the
machine is touched. Otherwise the command runs under a user-mode kernel, which sees this machine's files
read-only below a layer in memory; only the shared folder is kept. System calls there take some ten times
longer, so it proves functions, not timing.

Exit code: the command's; 124 time limit; 125 no kernel with CAN available (the reason is on stderr).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, NamedTuple

if not __package__:  # run as a script
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from drivers.errors import PlantError
from plant_fmu.stewart.build import TARGETS, find_compiler, this_machine
from tests.vcan import packages

UnavailableError = packages.UnavailableError
GUEST = Path(__file__).resolve().with_name("guest.py")
WHOLE_STATE = Path(__file__).resolve().with_name("xstate.c")
MEMORY_BYTES = 2 << 30
BOOT_LIMIT_S = 40.0
HALT_LIMIT_S = 10.0
UNAVAILABLE_EXIT = 125
MODULES = (
    "net/can/can.ko",
    "net/can/can-raw.ko",
    "net/can/can-bcm.ko",
    "drivers/net/can/dev/can-dev.ko",
    "drivers/net/can/vcan.ko",
    "drivers/net/can/vxcan.ko",
    "drivers/net/can/slcan/slcan.ko",
    "net/sched/sch_netem.ko",
    "net/sched/sch_plug.ko",
)


class Completed(NamedTuple):
    """Result of the command."""

    exit_code: int
    stdout: str
    stderr: str
    kernel: str
    """``running`` or ``uml``."""


def run(
    command: Sequence[str],
    *,
    limit_s: float,
    share: Path | None = None,
    kernel: str = "any",
    relay: tuple[IO[str], IO[str]] | None = None,
) -> Completed:
    """Run `command` next to an interface vcan0; `share` is the folder whose changes are kept.

    `kernel` is ``any``, ``running`` or ``uml``; `relay` gets stdout and stderr while the command runs.

    Raises
    ------
    UnavailableError
        No kernel with CAN is available here; the message gives the reason.
    """
    reasons = []
    for name, start in (("running", _start_namespace), ("uml", _start_uml)):
        if kernel not in ("any", name):
            continue
        with tempfile.TemporaryDirectory(prefix="hil-vcan-") as temporary:
            folder = Path(temporary).resolve()
            _write_job(folder, command, limit_s)
            try:
                with start(folder, share.resolve() if share else None) as process:
                    code = _await(process, folder, limit_s, relay)
            except UnavailableError as error:
                reasons.append(f"{name} kernel: {error}")
                continue
            return Completed(code, _text(folder / "stdout"), _text(folder / "stderr"), name)
    raise UnavailableError("; ".join(reasons))


def _write_job(folder: Path, command: Sequence[str], limit_s: float) -> None:
    """Write the job of the guest script; candump is put on its PATH even if it is not installed."""
    environment = dict(os.environ)
    if shutil.which("candump") is None:
        with contextlib.suppress(UnavailableError):
            search = environment.get("PATH", os.defpath)
            environment["PATH"] = f"{search}:{packages.unpacked() / 'usr/bin'}"
    job = {
        "command": list(command),
        "folder": str(Path.cwd()),
        "limit_s": limit_s,
        "environment": environment,
    }
    (folder / "job.json").write_text(json.dumps(job))


def _memory_folder() -> str:
    """Folder for the kernel's memory file: large enough, and not mounted noexec."""
    for folder in ("/dev/shm", tempfile.gettempdir()):
        with contextlib.suppress(OSError):
            status = os.statvfs(folder)
            if not status.f_flag & os.ST_NOEXEC and status.f_bavail * status.f_frsize > MEMORY_BYTES:
                return folder
    raise UnavailableError(f"neither /dev/shm nor {tempfile.gettempdir()} has 2 GiB that programs may run in")


@contextlib.contextmanager
def _start_namespace(folder: Path, _share: Path | None) -> Iterator[subprocess.Popen[bytes]]:
    """Start the guest script in a network namespace of the running kernel."""
    if not Path("/proc/self/ns/net").exists() or shutil.which("unshare") is None:
        raise UnavailableError("no network namespaces, or no `unshare`")
    rights = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    command = ["unshare", *rights, "--net", sys.executable, str(GUEST), str(folder)]
    with _session(command, folder / "log") as process:
        yield process


@contextlib.contextmanager
def _start_uml(folder: Path, share: Path | None) -> Iterator[subprocess.Popen[bytes]]:
    """Start a user-mode kernel whose first process, after a few mounts, is the guest script."""
    root = packages.unpacked()
    modules = next((root / "usr/lib/uml/modules").glob("*/kernel"))
    keep = [path for path in (folder, share) if path]
    if any(set(str(path)) & set(" \t\n,") for path in keep):
        raise UnavailableError(f"a blank or comma in {keep}")
    busybox = shlex.quote(str(root / "bin/busybox"))
    mounts = "\n".join(
        f"$bb mkdir -p /mnt/root{path} && $bb mount -t hostfs none /mnt/root{path} -o {path}" for path in keep
    )
    loads = "\n".join(f"$bb insmod {shlex.quote(str(modules / module))}" for module in MODULES)
    python = f"{shlex.quote(sys.executable)} {shlex.quote(str(GUEST))} {folder}"
    init = folder / "init"
    init.write_text(
        f"""#!{root / "bin/busybox"} sh
bb={busybox}
$bb mount -t proc proc /proc
$bb insmod {shlex.quote(str(modules / "fs/overlayfs/overlay.ko"))}
{loads}
$bb mount -t tmpfs -o mode=755 tmpfs /mnt
$bb mkdir /mnt/changed /mnt/work /mnt/root
$bb mount -t overlay overlay -o lowerdir=/,upperdir=/mnt/changed,workdir=/mnt/work /mnt/root
{mounts}
$bb mount -t proc proc /mnt/root/proc
$bb mount -t sysfs sysfs /mnt/root/sys
$bb mount -t devtmpfs devtmpfs /mnt/root/dev
exec $bb chroot /mnt/root {python}
"""
    )
    init.chmod(0o755)
    command = [
        str(root / "usr/bin/linux.uml"),
        *(
            f"mem={MEMORY_BYTES >> 20}M",
            "umid=guest",
            f"uml_dir={folder}",
            "con=null",
            "con0=null,fd:1",
            "ssl=null",
        ),
        *("rootfstype=hostfs", "rootflags=/", "ro", f"init={init}", "quiet", "random.trust_cpu=on"),
    ]
    environment = {
        "PATH": os.environ.get("PATH", os.defpath),
        "TMPDIR": _memory_folder(),
        "LD_PRELOAD": str(_whole_state(folder)),
    }
    with _session(command, folder / "log", environment) as process:
        yield process


def _whole_state(folder: Path) -> Path:
    """Compile the library that lets a kernel older than AMX run on a processor with it; see xstate.c."""
    try:
        compiler = find_compiler()
    except PlantError as error:
        raise UnavailableError(str(error)) from error
    library = folder / "xstate.so"
    options = ["-O2", "-shared", "-fPIC", *(["-target", TARGETS[this_machine()].zig] if compiler.zig else [])]
    command = [*compiler.command, *options, "-o", str(library), str(WHOLE_STATE), "-ldl"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UnavailableError(f"{WHOLE_STATE.name} does not compile: {done.stderr.strip()[-500:]}")
    return library


@contextlib.contextmanager
def _session(
    command: list[str], log: Path, environment: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Start `command` in its own session and kill all its processes afterwards."""
    with log.open("wb") as sink:
        process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=sink,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _await(
    process: subprocess.Popen[bytes],
    folder: Path,
    limit_s: float,
    relay: tuple[IO[str], IO[str]] | None,
) -> int:
    """Relay the output until the guest has ended; return the command's exit code."""
    seen = {"stdout": 0, "stderr": 0}
    started = time.monotonic()
    while True:
        gone = process.poll() is not None
        ready = (folder / "ready").exists()
        if relay:
            for name, sink in zip(seen, relay, strict=True):
                text = _text(folder / name)[seen[name] :]
                seen[name] += len(text)
                sink.write(text)
                sink.flush()
        if gone or time.monotonic() - started > BOOT_LIMIT_S + (limit_s + HALT_LIMIT_S if ready else 0.0):
            break
        time.sleep(0.05)
    if not ready:
        reason = _text(folder / "refused")
        if not reason:
            lines = _text(folder / "log").strip().splitlines()[-6:]
            reason = "it did not start: " + (" | ".join(lines) or "no message")
        raise UnavailableError(reason)
    code = _text(folder / "exit_code")
    if not code:
        raise RuntimeError(f"the guest was lost while the command ran:\n{_text(folder / 'log')[-2000:]}")
    return int(code)


def _text(path: Path) -> str:
    return path.read_text(errors="replace") if path.exists() else ""


def main() -> int:
    """Command line; return the exit code."""
    parser = argparse.ArgumentParser(description="Run a command where vcan0 exists.")
    parser.add_argument("--limit", type=float, default=60.0, metavar="S", help="time limit of the command")
    parser.add_argument("--share", type=Path, metavar="FOLDER", help="folder whose changes stay")
    parser.add_argument("--kernel", choices=["any", "running", "uml"], default="any")
    parser.add_argument("command", nargs="+")
    arguments = parser.parse_args()
    try:
        done = run(
            arguments.command,
            limit_s=arguments.limit,
            share=arguments.share,
            kernel=arguments.kernel,
            relay=(sys.stdout, sys.stderr),
        )
    except UnavailableError as error:
        print(f"no virtual CAN here: {error}", file=sys.stderr)
        return UNAVAILABLE_EXIT
    return done.exit_code


if __name__ == "__main__":
    sys.exit(main())
