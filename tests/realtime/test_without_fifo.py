"""Runs without the right to SCHED_FIFO: as an ordinary user, next to a busy process."""

from __future__ import annotations

import contextlib
import os
import pwd
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.compiled.cache import CACHE_FOLDER
from tests.realtime.rig import ROOT, Process, configuration

pytestmark = pytest.mark.realtime

Start = Callable[..., Process]


PROBE = (
    "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import hil.app.run.command'], check=True)"
)


def without_rights() -> None:
    """Forbid real-time priority; called in the child process."""
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder writable by another user; pytest would restrict its own folders again in the next session."""
    with tempfile.TemporaryDirectory(prefix="hil-test-") as name:
        Path(name).chmod(0o777)
        yield Path(name)


@pytest.fixture(scope="module")
def ordinary() -> Iterator[dict[str, Any]]:
    """Options to start a process as an ordinary user with a copy of this user's caches, to avoid compiling."""
    if os.getuid() != 0:
        yield {"preexec_fn": without_rights}
        return
    with tempfile.TemporaryDirectory(prefix="hil-test-") as home:
        yield as_user("nobody", Path(home))


def as_user(name: str, home: Path) -> dict[str, Any]:
    """Options to start a process as that user, with a copy of this user's caches in `home`."""
    user = pwd.getpwnam(name)
    shutil.copytree(CACHE_FOLDER, home / ".cache" / CACHE_FOLDER.name)
    for path in (home, *home.rglob("*")):
        os.chown(path, user.pw_uid, user.pw_gid)
    variables = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "NUMBA_"))}
    variables["HOME"] = str(home)
    reads = "-all,+dac_read_search"
    drop = ["setpriv", f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"]
    # an interpreter or a checkout in root's home is readable with one capability more; it is not about time
    ways = (drop, [*drop, f"--inh-caps={reads}", f"--ambient-caps={reads}"])
    for prefix in ways:
        with contextlib.suppress(FileNotFoundError):
            probe = [*prefix, sys.executable, "-c", PROBE]
            if not subprocess.run(
                probe, cwd=ROOT, env=variables, capture_output=True, check=False
            ).returncode:
                return {"prefix": prefix, "env": variables}
    pytest.skip(f"user {user.pw_name} cannot read this installation")


@pytest.fixture
def busy() -> Iterator[None]:
    """Keep one processor busy."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.mark.long
@pytest.mark.usefixtures("busy")
def test_run_without_real_time_scheduling_next_to_a_busy_process_reduces_its_rate(
    folder: Path, start: Start, ordinary: dict[str, Any]
) -> None:
    changes = {"on_stall: stretch": "on_stall: fault"}
    file = configuration(folder, changes, short=True, patient=False)
    run = start("run", str(file), "--plant", folder=folder, **ordinary)

    code, summary = run.wait(), run.summary
    assert code == 0, run.errors
    assert summary["success"]
    assert "bench_time" not in summary
    assert 100 <= summary["rate_Hz"] < 1000
    said = " ".join(run.errors.split())
    assert "no right to SCHED_FIFO" in said
    assert f"the loop runs at {summary['rate_Hz']:g} Hz instead of 1000 Hz" in said
    assert any("SCHED_FIFO" in text for text in summary["real_time"]["missing"])
    assert summary["tracking"]["peak_leg_error_mm"] < 10
    assert summary["replay"]["exact"]
    assert "Traceback" not in run.errors


@pytest.mark.long
@pytest.mark.realtime(patient=True)
def test_run_without_real_time_scheduling_is_refused_at_the_start_if_configured_so(
    folder: Path, start: Start, ordinary: dict[str, Any]
) -> None:
    file = configuration(folder, {"without_realtime: slow": "without_realtime: refuse"}, short=True)
    run = start("run", str(file), "--plant", folder=folder, **ordinary)

    assert run.wait() == 2
    (line,) = run.messages
    assert line.startswith("hil: no right to SCHED_FIFO")
    assert "loop.without_realtime is `refuse`" in line
    assert not (folder / "runs").exists()
