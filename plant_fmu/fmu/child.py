"""An FMU in a process of its own: class ChildHost, and the program of that process.

Requests and answers pass through a pair of sockets. Whatever the FMU does to its process (crash, hang, exit,
change of directory or rounding mode), our process gets a PlantError.
"""

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.child_process import start
from drivers.errors import HilError, PlantError, require_linux
from plant_fmu.config import FmuPlant
from plant_fmu.fmu.check import FmuSpec, fmu_spec
from plant_fmu.fmu.host import FmuHost
from plant_fmu.plant import Plant, Robot, Truth

START_TIMEOUT_S = 60.0
STEP_TIMEOUT_S = 5.0
CLOSE_TIMEOUT_S = 10.0
"""Time limit for freeing the FMU and ending the interpreter."""
_LIFE_CHECK_MS = 1000


class ChildHost:
    """Plant whose FMU runs in a child process.

    Mutable state: the child process, the true state of its last answer, why a reset failed. The child ends
    with our process, however that ends. An FMU that cannot be reset in it is loaded in a new child.
    """

    def __init__(self, spec: FmuSpec) -> None:
        """Start the child; load and initialise the FMU there. Raises PlantError with the child's reason."""
        self.spec = spec
        self.internal_step_s = spec.step_us / 1e6
        self._truth: Truth | None = None
        self._cannot_reset = ""
        # The child unpacks here; the process that ends last removes it.
        self._folder = tempfile.TemporaryDirectory(prefix="fmu-", ignore_cleanup_errors=True)
        self._start()

    def _start(self) -> None:
        self._ended: str | None = None
        spec = self.spec
        self._line, theirs = Pipe()
        self._poll = select.poll()
        self._poll.register(self._line, select.POLLIN)
        try:
            # Standard output belongs to this process (e.g. a summary), and only this process handles Ctrl-C.
            self._process = start(
                "plant_fmu.fmu.child",
                *map(str, (theirs.fileno(), os.getpid(), self._folder.name)),
                environment={"TMPDIR": self._folder.name},
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=2,
                start_new_session=True,
            )
        except OSError as error:
            self._line.close()
            self._folder.cleanup()
            raise PlantError(
                f"{spec.path}: the child process of the FMU cannot be started: {error}"
            ) from error
        finally:
            theirs.close()
        try:
            self._ask(spec, START_TIMEOUT_S, "load")
        except BaseException:
            self.close()
            raise

    def _end(self, reason: str) -> PlantError:
        self._ended = reason
        self._process.kill()
        self._process.wait()
        return PlantError(reason)

    def _ask(self, question: Any, timeout_s: float, what: str) -> Any:
        if self._ended is not None:
            raise PlantError(self._ended)
        try:
            self._line.send(question)
            if not self._poll.poll(timeout_s * 1e3):
                late = f"the FMU did not {what} within {timeout_s:g} s; its process was stopped"
                raise self._end(f"{self.spec.path}: {late}")
            answer = self._line.recv()
        except (EOFError, OSError):  # it has ended
            code = self._process.wait()
            ended = f"ended itself with exit code {code}"
            how = f"died of {signal.Signals(-code).name}" if code < 0 else ended
            raise self._end(
                f"{self.spec.path}: the FMU's process {how} during {what}; "
                f"its memory limit is {self.spec.memory_GB:g} GB (plant.model.memory_GB)"
            ) from None
        if isinstance(answer, str):
            raise PlantError(answer)
        return answer

    def reset(self) -> tuple[Array, Array]:
        """Reset as `FmuHost.reset`; afterwards the child has the caller's real-time scheduling."""
        if self._ended is None:
            if not self._cannot_reset:
                try:
                    return self._reset()
                except PlantError as error:
                    self._cannot_reset = str(error).removeprefix(f"{self.spec.path}: ")
            self._end("")
            self._line.close()
            self._start()
        return self._reset()

    def _reset(self) -> tuple[Array, Array]:
        _follow(self._process.pid)
        return self._measured(("reset",), START_TIMEOUT_S)

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        """Step as `FmuHost.step`; also raises PlantError when the FMU hangs or its process dies."""
        # Lists: pickling an array takes ten times as long.
        question = "step", force.tolist(), brake.tolist(), wrench.tolist(), dt_s
        return self._measured(question, STEP_TIMEOUT_S)

    def _measured(self, question: tuple[Any, ...], timeout_s: float) -> tuple[Array, Array]:
        measured, self._truth = self._ask(question, timeout_s, question[0])
        return np.array(measured[0]), np.array(measured[1])

    def truth(self) -> Truth | None:
        """True pose, twist and forces; needs no request, as every answer of the child contains them."""
        if self._ended is not None:
            raise PlantError(self._ended)
        return self._truth

    def rod_force(self) -> Array | None:
        """Forces (6,) N between drives and rods; None if the FMU's output for them is unknown."""
        return self._ask(("rod_force",), STEP_TIMEOUT_S, "report")  # type: ignore[no-any-return]

    def notes(self) -> list[str]:
        """Warnings of the FMU in this child; for a child that has ended, only those of its reset."""
        found = f"the FMU cannot be reset, so each new start gets a fresh process: {self._cannot_reset}"
        own: list[str] = []
        if self._ended is None:
            with contextlib.suppress(PlantError):  # it has ended
                own = self._ask(("notes",), STEP_TIMEOUT_S, "report")
        return [found] * bool(self._cannot_reset) + own

    def close(self) -> None:
        """Let the child free the FMU and end; kill it after a timeout. A second call does nothing."""
        if self._line.closed:
            return
        with contextlib.suppress(OSError):  # it has ended
            self._line.send(None)
        try:
            self._process.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._line.close()  # last: the child ends at once, without cleaning up, when it closes
        self._ended = self._ended or f"{self.spec.path}: the FMU is closed"
        self._folder.cleanup()


def host(spec: FmuSpec) -> Plant:
    """Host an FMU in this process or a child, by `spec.isolation`. Raises PlantError if that fails."""
    if spec.isolation == "in_process":
        return FmuHost(spec)
    require_linux(f"{spec.path}: an FMU in a process of its own (plant.model.isolation)")
    return ChildHost(spec)


def fmu_plant(model: FmuPlant, _: Robot, folder: Path) -> Plant:
    """Host the FMU of section `plant.model`. Raises PlantError if that fails."""
    return host(fmu_spec(model, folder))


def _follow(child: int) -> None:
    """Give the child our SCHED_FIFO, one priority below ours, so that we can stop it when it hangs.

    Without it, a loop that waits for the child waits for everything else on the machine. The child keeps its
    scheduling if ours is another, or the permission is missing.
    """
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_FIFO:
        return
    priority = max(1, os.sched_getparam(0).sched_priority - 1)
    with contextlib.suppress(OSError):  # it has ended; the next request reports this
        os.sched_setscheduler(child, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))


def _end_with_parent(line: Connection, parent: int, folder: str) -> None:
    """End this process when the parent's end of the line closes, even while the FMU hangs in C."""
    closed = select.poll()
    closed.register(line, select.POLLHUP)
    while not closed.poll(_LIFE_CHECK_MS):
        # Another process forked by the parent may keep that end open: check the parent, too.
        if os.getppid() != parent:
            break
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _bound_memory(most_GB: float) -> None:
    """Limit the private memory of this process; a lower limit of the machine stays."""
    import resource  # noqa: PLC0415 - not on Windows

    most = round(most_GB * 1e9)
    _, allowed = resource.getrlimit(resource.RLIMIT_DATA)
    if allowed != resource.RLIM_INFINITY:
        most = min(most, allowed)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def serve(line: Connection, parent: int, folder: str) -> None:
    """Main loop of the child: load an FMU, then answer requests until None or the parent's end.

    A request has the name of a method of FmuHost and its arguments.
    """
    ending = threading.Thread(target=_end_with_parent, args=(line, parent, folder), daemon=True)
    ending.start()
    host: FmuHost | None = None
    answer: Any
    try:
        while (question := line.recv()) is not None:
            try:
                if host is None:
                    _bound_memory(question.memory_GB)
                    host, answer = FmuHost(question), None
                else:
                    answer = getattr(host, question[0])(*question[1:])
                    if question[0] in ("reset", "step"):
                        answer = [each.tolist() for each in answer], host.truth()
            except HilError as error:
                answer = str(error)
            except MemoryError:
                answer = "the FMU's process is out of memory; its limit is plant.model.memory_GB"
            line.send(answer)
        if host is not None:
            with contextlib.suppress(PlantError):  # an FMU that cannot be freed ends with its process
                host.close()
    except (EOFError, ConnectionError):  # the parent is gone
        ending.join()


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])), int(sys.argv[2]), sys.argv[3])
