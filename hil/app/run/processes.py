"""Runs `hil plant` and `hil watch` as child processes of `hil run`, which end soon after it in any case."""

import json
import os
import select
import signal
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, Self

from drivers.child_process import start
from drivers.errors import PlantError
from hil.app.configuration.configuration import Configuration

START_S = 60.0
"""Includes building the FMU, compiling, and the end of a plant whose daemon was killed."""
END_S = 20.0
"""Longest time to close the plant's log."""
WATCH_END_S = 5.0
LAST_BYTES = 4096
LAST_LINES = 10
"""Limits of the plant's last output in a message: its model may print in each step."""


class _Child:
    """A `hil` command in its own process and session, so that Ctrl-C reaches the daemon only.

    It ends when a pipe closes, which happens with any end of the daemon.
    """

    def __init__(self, *words: str, pass_fds: tuple[int, ...] = (), stderr: IO[bytes] | None = None) -> None:
        alive, self._alive = os.pipe()
        self._process = start(
            "hil.cli",
            *words,
            "--supervisor",
            str(alive),
            pass_fds=(alive, *pass_fds),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,
        )
        os.close(alive)

    def _wait(self, longest_s: float) -> None:
        try:
            self._process.wait(longest_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class WatchProcess(_Child):
    """Child process `hil watch`, which prints its own link and ends with the run."""

    def __init__(self, c: Configuration) -> None:
        super().__init__("watch", c.source)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._alive)
        self._wait(WATCH_END_S)


class SupervisedPlant(_Child):
    """Child process `hil plant`, the other end of the bus.

    The platform is parked before the process ends. It reports through a second pipe: an empty line when it
    serves, its summary at the end. Its errors go to an unnamed file, which vanishes with the processes.

    Mutable state: the process, the pipes, and the plant's unexpected end.
    """

    def __init__(
        self,
        configuration: Configuration,
        log: Path,
        faults: Iterable[str] = (),
        watchdog_s: float | None = None,
    ) -> None:
        """Start the plant. watchdog_s: of drives whose watchdog no frame sets; default: as configured."""
        self._said = b""
        self._trouble: str | None = None
        self._report, report = os.pipe()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed by __exit__
        words = [word for fault in faults for word in ("--fault", fault)]
        if watchdog_s is not None:
            words += ["--watchdog", repr(watchdog_s)]
        super().__init__(
            "plant", configuration.source, "--log", str(log), "--report", str(report), *words,
            pass_fds=(report,), stderr=self._errors,
        )  # fmt: skip
        os.close(report)

    def __enter__(self) -> Self:
        """Wait until the plant serves its drives.

        Raises PlantError, with the plant's own message, if it does not start in time.
        """
        try:
            readable, _, _ = select.select([self._report], [], [], START_S)
            served = bool(readable) and os.read(self._report, 1) == b"\n"
        except BaseException:
            self.__exit__()
            raise
        if not served:
            self._end()
            message = self._message() if readable else _late(self._last_words())
            self.__exit__()
            raise PlantError(f"the plant did not start: {message}")
        return self

    @property
    def pid(self) -> int:
        """Process identifier of the plant."""
        return self._process.pid

    def trouble(self) -> str:
        """Unexpected end of the plant as a sentence; empty while the plant runs."""
        if self._trouble is None and self._process.poll() is not None:
            self._trouble = f"the plant, process {self.pid}, {self._message()}"
        return self._trouble or ""

    def finish(self) -> dict[str, Any]:
        """Terminate the plant and return its summary."""
        before = self.trouble()
        self._end()
        while piece := os.read(self._report, 65536):
            self._said += piece
        try:
            summary: dict[str, Any] = json.loads(self._said)
        except ValueError:
            return {"success": False, "trouble": before or self._message()}
        return summary

    def _end(self) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            self._wait(END_S)

    def _message(self) -> str:
        text = self._last_words()
        code = self._process.returncode
        how = f"ended with exit code {code}"
        if code and code < 0:
            how = f"was killed by {signal.Signals(-code).name}"
        return f"{how}: {text}" if text else how

    def _last_words(self) -> str:
        """Last lines of the plant's output, at most LAST_LINES and LAST_BYTES."""
        file = self._errors.fileno()
        before = max(0, os.fstat(file).st_size - LAST_BYTES)
        lines = os.pread(file, LAST_BYTES, before).decode(errors="replace").splitlines()
        whole = lines[1:] if before and len(lines) > 1 else lines
        return "\n".join([line for line in whole if line.strip()][-LAST_LINES:]).strip()

    def __exit__(self, *error: object) -> None:
        self._end()
        if not self._errors.closed:
            self._errors.close()
            os.close(self._alive)
            os.close(self._report)


def _late(last_words: str) -> str:
    text = (
        f"it did not serve within {START_S:g} s and was stopped. The first start on a machine compiles: "
        "`hil sim` with this configuration also does that, without a time limit; then try again"
    )
    return f"{text}. Its last output: {last_words}" if last_words else text
