"""An FMU in a process of its own: ChildHost, and the program that runs there.

Numbers cross in shared memory, one byte on a pipe says that they are there. Whatever the FMU does to its
process (crash, hang, exit, change of directory or rounding mode), ours sees a PlantError.
"""

import contextlib
import mmap
import os
import pickle
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.child_process import start
from drivers.errors import HilError, PlantError
from plant_fmu.config import FmuPlant
from plant_fmu.fmu.check import FmuSpec, fmu_spec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.plant import Plant, Truth, truth_of

START_TIMEOUT_S = 60.0
STEP_TIMEOUT_S = 5.0
_RESET, _STEP, _TRUTH, _CLOSE = range(4)
_OK, _REFUSED = range(2)
_LAYOUT = np.dtype(
    [(name, "i8") for name in ("command", "status")]
    + [(name, "f8", 6) for name in ("force", "brake", "wrench")]
    + [("dt", "f8"), ("measured", "f8", 12), ("truth", "f8", 24), ("text", "S4096")]
)
_LIFE_CHECK_MS = 1000


def _board_in(memory: mmap.mmap) -> Any:
    """Return the record of `_LAYOUT` in the shared memory; behind it stands the spec."""
    return np.frombuffer(memory, _LAYOUT, 1)[0]


class ChildHost:
    """Plant in front of an FMU in a child process.

    Mutable state: the child process and the shared memory. The child ends with us, however we end.
    """

    def __init__(self, spec: FmuSpec) -> None:
        """Start the child, load the FMU there, initialise. Raises PlantError with the child's reason."""
        self.spec = spec
        self.internal_step_s = spec.step_s
        self._ended: str | None = None
        # The child unpacks in here; whichever of us two is left removes it.
        self._folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
        given_spec = pickle.dumps(spec)
        size = _LAYOUT.itemsize + len(given_spec)
        memory_fd = os.memfd_create("fmu-board")
        command_r, self._command_w = os.pipe()
        self._reply_r, reply_w = os.pipe()
        life_r, self._life_w = os.pipe()
        try:
            os.ftruncate(memory_fd, size)
            memory = mmap.mmap(memory_fd, size)
            memory[_LAYOUT.itemsize :] = given_spec
            self._board = _board_in(memory)
            given = (memory_fd, command_r, reply_w, life_r)
            # Standard output is ours (a summary may go there); Ctrl-C is for us to handle, hence the session.
            self._process = start(
                "plant_fmu.fmu.child",
                *map(str, (*given, os.getpid(), self._folder.name)),
                environment={"TMPDIR": self._folder.name},
                pass_fds=given,
                stdin=subprocess.DEVNULL,
                stdout=2,
                start_new_session=True,
            )
        except OSError as error:
            for fd in (self._command_w, self._reply_r, self._life_w):
                os.close(fd)
            self._folder.cleanup()
            raise PlantError(f"{spec.path}: no child process for the FMU: {error}") from error
        finally:
            for fd in (memory_fd, command_r, reply_w, life_r):
                os.close(fd)
        self._poll = select.poll()
        self._poll.register(self._reply_r, select.POLLIN)
        try:
            self._wait(START_TIMEOUT_S, "load")
        except BaseException:
            self.close()
            raise

    def _end(self, reason: str) -> PlantError:
        self._ended = reason
        self._process.kill()
        self._process.wait()
        return PlantError(reason)

    def _wait(self, timeout_s: float, what: str) -> None:
        """Wait for the child's byte and pass its refusal on."""
        if not self._poll.poll(timeout_s * 1e3):
            raise self._end(
                f"{self.spec.path}: the FMU did not {what} within {timeout_s:g} s; its process was stopped"
            )
        if not os.read(self._reply_r, 1):
            code = self._process.wait()
            ended = f"ended itself with exit code {code}"
            how = f"died of {signal.Signals(-code).name}" if code < 0 else ended
            raise self._end(
                f"{self.spec.path}: the FMU's process {how} when it was to {what}; "
                f"it may have {self.spec.memory_GB:g} GB of memory (plant.model.memory_GB)"
            )
        if self._board["status"] != _OK:
            raise PlantError(bytes(self._board["text"]).decode("utf-8", "replace"))

    def _ask(self, command: int, timeout_s: float, what: str) -> None:
        if self._ended is not None:
            raise PlantError(self._ended)
        self._board["command"] = command
        with contextlib.suppress(BrokenPipeError):  # the reply pipe tells how the child ended
            os.write(self._command_w, b"!")
        self._wait(timeout_s, what)

    def _measured(self) -> tuple[Array, Array]:
        y = self._board["measured"].copy()
        return y[:6], y[6:]

    def reset(self) -> tuple[Array, Array]:
        """As FmuHost.reset. From here on the child has the real-time scheduling of the calling process."""
        _follow(self._process.pid)
        self._ask(_RESET, START_TIMEOUT_S, "reset")
        return self._measured()

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """As FmuHost.step; also raises PlantError when the FMU hangs or its process dies."""
        if self._ended is not None:
            raise PlantError(self._ended)
        for name, value in (("force", force), ("brake", brake), ("wrench", wrench), ("dt", dt_s)):
            self._board[name] = value
        self._ask(_STEP, STEP_TIMEOUT_S, "step")
        return self._measured()

    def truth(self) -> Truth | None:
        """As FmuHost.truth."""
        if not self.spec.truth:
            return None
        self._ask(_TRUTH, STEP_TIMEOUT_S, "give its outputs")
        return truth_of(self._board["truth"].copy())

    def applied_force(self) -> Array | None:
        """As FmuHost.applied_force, at no cost: it comes with the answer to every step."""
        return self._board["truth"][18:24].copy() if self.spec.truth else None

    def close(self) -> None:
        """Let the child free the FMU and end; stop it if it does not. A second call does nothing."""
        if self._life_w < 0:
            return
        if self._ended is None:
            try:
                self._ask(_CLOSE, STEP_TIMEOUT_S, "close")
            except PlantError:
                self._process.kill()  # an FMU that cannot be freed goes with its process
        os.close(self._command_w)
        try:
            self._process.wait(START_TIMEOUT_S)  # an interpreter's end takes its time, too
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        # Last: the child ends at once, without cleaning up, when its life line closes.
        for fd in (self._life_w, self._reply_r):
            os.close(fd)
        self._life_w = -1
        self._ended = self._ended or f"{self.spec.path}: the FMU is closed"
        del self._board  # and the memory with it
        self._folder.cleanup()


def host(spec: FmuSpec, isolation: str) -> Plant:
    """Load an FMU `in_process` or in a `child_process`. Raises PlantError."""
    return FmuHost(spec) if isolation == "in_process" else ChildHost(spec)


def fmu_plant(settings: FmuPlant, folder: Path) -> Plant:
    """Host a configured FMU; a relative path starts at `folder`, the configuration's. Raises PlantError."""
    return host(fmu_spec(settings, folder), settings.isolation)


def _follow(child: int) -> None:
    """Give the child our SCHED_FIFO, one priority below ours: who waits for it can stop it when it hangs.

    A loop that waits for a process without it waits for whatever else runs on the machine. Without the
    right to it, or in a process that has none, the child keeps what it has.
    """
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_FIFO:
        return
    priority = max(1, os.sched_getparam(0).sched_priority - 1)
    with contextlib.suppress(OSError):  # it has ended, which the next question says
        os.sched_setscheduler(child, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _end_with_parent(life_fd: int, parent: int, folder: str) -> None:
    """End this process when the parent's end of the life line closes, even while the FMU hangs in C."""
    line = select.poll()
    line.register(life_fd, select.POLLHUP)
    while not line.poll(_LIFE_CHECK_MS):
        # A grandchild forked by the parent may hold the life line open: look at the parent, too.
        if os.getppid() != parent:
            break
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _bound_memory(most_GB: float) -> None:
    """Let this process have no more memory of its own; a lower limit of the machine's stays."""
    most = round(most_GB * 1e9)
    _, allowed = resource.getrlimit(resource.RLIMIT_DATA)
    if allowed != resource.RLIM_INFINITY:
        most = min(most, allowed)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _attempt(board: Any, work: Callable[[], Any]) -> Any:
    try:
        result = work()
    except (HilError, MemoryError) as error:
        board["status"] = _REFUSED
        full = "no memory is left for the FMU's process: plant.model.memory_GB bounds it"
        board["text"] = (full if isinstance(error, MemoryError) else str(error)).encode()
        return None
    board["status"] = _OK
    return result


def serve(memory_fd: int, command_fd: int, reply_fd: int, life_fd: int, parent: int, folder: str) -> None:
    """Run in the child: load the FMU, then answer commands until told to close or the parent is gone."""
    threading.Thread(target=_end_with_parent, args=(life_fd, parent, folder), daemon=True).start()
    memory = mmap.mmap(memory_fd, 0)
    board = _board_in(memory)
    spec: FmuSpec = pickle.loads(memory[_LAYOUT.itemsize :])  # noqa: S301 - from who started us
    _bound_memory(spec.memory_GB)
    host: FmuHost | None = _attempt(board, lambda: FmuHost(spec))
    os.write(reply_fd, b"!")
    if host is None:
        return

    force, brake, wrench = (board[name] for name in ("force", "brake", "wrench"))

    def true_state() -> None:
        truth = host.truth()
        if truth is not None:
            parts = truth.p, truth.R.ravel(), truth.twist, truth.applied_force
            board["truth"] = np.concatenate(parts)

    def measure(answer: tuple[Array, Array]) -> None:
        board["measured"] = np.concatenate(answer)
        true_state()

    tasks: dict[int, Callable[[], None]] = {
        _RESET: lambda: measure(host.reset()),
        _STEP: lambda: measure(host.step(force, brake, wrench, float(board["dt"]))),
        _TRUTH: true_state,
        _CLOSE: host.close,
    }
    while os.read(command_fd, 1):
        command = int(board["command"])
        _attempt(board, tasks[command])
        with contextlib.suppress(BrokenPipeError):  # the parent is gone: the next read says so
            os.write(reply_fd, b"!")
        if command == _CLOSE:
            return
    host.close()
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    memory_fd, command_fd, reply_fd, life_fd, parent = map(int, sys.argv[1:6])
    serve(memory_fd, command_fd, reply_fd, life_fd, parent, sys.argv[6])
