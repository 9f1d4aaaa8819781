"""`hil plant` as a child of `hil run --plant`: started, watched, told to end, never orphaned for long."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.errors import PlantError
from hil.app.configuration import Configuration

START_S = 60.0
"""Building the FMU and compiling may come first."""


class SupervisedPlant:
    """The other end of the bus in a process of its own.

    It has its own session, so that Ctrl-C reaches the daemon alone and the platform is parked before the
    plant ends. It notices the daemon's death by the closed pipe and then ends by itself.
    """

    def __init__(self, configuration: Configuration, log: Path) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="hil-plant-")
        self._summary = Path(self._folder.name) / "summary.json"
        self._errors = Path(self._folder.name) / "stderr"
        alive_read, self._alive = os.pipe()
        self._ready, ready_write = os.pipe()
        command = [
            sys.executable, "-m", "hil.cli", "plant", configuration.source,
            "--log", str(log), "--json", str(self._summary),
            "--supervisor", str(alive_read), "--ready", str(ready_write),
        ]  # fmt: skip
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(
                command,
                pass_fds=(alive_read, ready_write),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
            )
        os.close(alive_read)
        os.close(ready_write)

    def __enter__(self) -> Self:
        """Wait until the plant serves its drives.

        Raises PlantError with the plant's own message if it does not start.
        """
        readable, _, _ = select.select([self._ready], [], [], START_S)
        if not readable or os.read(self._ready, 1) != b"1":
            self._end()
            raise PlantError(f"the plant did not start: {self._message()}")
        return self

    @property
    def pid(self) -> int:
        """Process number of the plant."""
        return self._process.pid

    def finish(self) -> dict[str, Any]:
        """End the plant and return its summary."""
        self._end()
        try:
            summary: dict[str, Any] = json.loads(self._summary.read_text())
        except (OSError, ValueError):
            return {"success": False, "trouble": self._message()}
        return summary

    def _end(self) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(20.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _message(self) -> str:
        text = self._errors.read_text(errors="replace").strip()
        return text or f"it ended with exit code {self._process.returncode} and said nothing"

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._end()
        for fd in (self._alive, self._ready):
            with contextlib.suppress(OSError):
                os.close(fd)
        self._folder.cleanup()
