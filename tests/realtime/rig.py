"""Test rig for real time: processes over localcan, a listener on their bus, signals to single processes.

All tests of a session use the same channel. The next test must start on whatever a killed test left behind,
without cleaning up.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.can.bus import Bus
from drivers.signals import LEGS, NEVER, DriveMode
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.contracts.messages import DeviceCommand, Sync
from hil.loop.clock import fifo_allowed
from tests.drivers.legs_frames import decode, parse
from tests.drivers.received_frames import got

ROOT = Path(__file__).resolve().parents[2]
CHANNEL = "test-" + os.environ.get("PYTEST_XDIST_TESTRUNUID", str(os.getpid()))[:12]
START_S = 120.0
"""Longest start, s, which may include compiling."""
END_S = 60.0
SHORT = """\
    - {t_s: 0, position_m: [0, 0, 1], rotation_vector_deg: [0, 0, 0]}
    - {t_s: 0.5, position_m: [0.0625, 0.125, 0.9375], rotation_vector_deg: [1.25, 2.5, 3.75]}
    - {t_s: 1, position_m: [0, 0, 1], rotation_vector_deg: [0, 0, 0]}
"""
"""A quarter of the book's path in half its time, with the same acceleration. One second."""
PATIENT = {
    "rate_Hz: 1000": "rate_Hz: 500",
    "watchdog_ms: 10 ": "watchdog_ms: 150 ",
    "stale_fault_ticks: 5": "stretch_percent: 100\n  stale_fault_ticks: 60\n  missed_stop_ticks: 60",
}
LASTING = {"periods: 3": "periods: 1000"}
"""A path that lasts until it is ended, however late that is."""
FIFO = fifo_allowed(80)


def configuration(
    folder: Path, changes: dict[str, str] | None = None, *, short: bool = False, patient: bool = True
) -> Path:
    """Write configs/virtual.yaml with the test's own channel and log folder, and with text changes.

    patient: no fault from a stall of a tenth of a second, as occurs on a loaded or virtual machine: half the
    rate, longer watchdog, higher limits for stale ticks and missed periods. Otherwise the timing is the
    shipped one. Bench time may pause without limit.
    """
    text = (ROOT / "configs" / "virtual.yaml").read_text()
    if short:
        first = text.index("    - {t_s: 0, ")
        last = text.index("\n", text.index("    - {t_s: 2, ")) + 1
        text = text[:first] + SHORT + text[last:]
    edits = {
        "channel: hil0": f"channel: {CHANNEL}",
        "folder: runs": f"folder: {folder}/runs",
        "periods: 10": "periods: 1" if short else "periods: 3",
        "brake_release_s: 0.1": "brake_release_s: 0.05",
        "force_ramp_s: 0.3": "force_ramp_s: 0.2",
        "stale_fault_ticks: 5": "stretch_percent: 100\n  stale_fault_ticks: 5",
        **(PATIENT if patient else {}),
    }
    for old, new in (*edits.items(), *(changes or {}).items()):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    file = folder / "rig.yaml"
    file.write_text(text)
    return file


class Process:
    """One `hil` command. State: the process, and its known descendants."""

    def __init__(
        self,
        folder: Path,
        *arguments: str,
        entry: str = "hil.cli",
        prefix: Sequence[str] = (),
        **options: Any,
    ) -> None:
        self.json = folder / f"{arguments[0]}-{time.monotonic_ns()}.json"
        self._errors = self.json.with_suffix(".err")
        arm = ["--arm"] if arguments[0] == "run" else []
        command = [*prefix, sys.executable, "-m", entry, *arguments, *arm, "--json", str(self.json)]
        options = {"cwd": ROOT, **options}
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
                **options,
            )
        self.pid = self._process.pid
        self.family: dict[str, int] = {}

    def find_family(self) -> dict[str, int]:
        """Process ids of `daemon`, its `recorder`, its `plant` and the `plant's recorder`."""
        recorder, plant = _child(self.pid, "hil.record"), _child(self.pid, "hil.cli plant")
        self.family = {
            "daemon": self.pid,
            "recorder": recorder,
            "plant": plant,
            "plant's recorder": _child(plant, "hil.record"),
        }
        return self.family

    def wait_for_child(self, words: str) -> int:
        """Wait for a child process with `words` in its command line; return its id."""
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            with contextlib.suppress(AssertionError):
                return _child(self.pid, words)
            assert not gone(self.pid), self.errors
            time.sleep(0.01)
        raise AssertionError(self.errors)

    def wait(self, timeout_s: float = END_S) -> int:
        """Wait for the end; return the exit code."""
        return self._process.wait(timeout_s)

    @property
    def errors(self) -> str:
        return self._errors.read_text()

    @property
    def messages(self) -> list[str]:
        """Lines on standard error, without the remark on compiling."""
        return [line for line in self.errors.splitlines() if not line.startswith("compiling the mathematics")]

    @property
    def summary(self) -> dict[str, Any]:
        summary: dict[str, Any] = json.loads(self.json.read_text())
        return summary

    def interrupt(self) -> None:
        """Ctrl-C: SIGINT to the whole process group, as a terminal does."""
        os.killpg(self.pid, signal.SIGINT)

    def clean_up(self) -> None:
        """Kill the remaining processes by their ids."""
        for pid in (self.pid, *self.family.values()):
            if not gone(pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        self._process.wait(10.0)


def _child(parent: int, words: str) -> int:
    for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
            if words in Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode():
                return int(pid)
    raise AssertionError(f"process {parent} has no child {words}")


def gone(pid: int) -> bool:
    """True if a process has ended, or is a zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def wait_until_gone(*pids: int, timeout_s: float = 20.0) -> None:
    """Wait until all processes have ended by themselves."""
    end = time.monotonic() + timeout_s
    while not all(map(gone, pids)):
        assert time.monotonic() < end, f"still there: {[p for p in pids if not gone(p)]}"
        time.sleep(0.02)


class Listener:
    """A third participant on the bus that only listens. State: the last values received."""

    def __init__(self, file: Path) -> None:
        c = load(str(file))
        self._protocol = build_protocol(c)
        self._bus = Bus.open(c.bus, role="listener")
        self._rate = np.zeros(LEGS)
        self._counter = 0
        self.mode = -1
        """Mode of the last command."""
        self.last_sync_ns = 0

    def look(self) -> None:
        """Receive pending frames; wait for them 20 ms at most."""
        for received in got(self._bus.wait(self._bus.clock.now() + 20_000_000)):
            match parse(self._protocol, received.frame):
                case Sync(counter=counter):
                    self._counter, self.last_sync_ns = counter, received.t_ns
                case DeviceCommand(mode=mode):
                    self.mode = mode
                case _:
                    heard = decode(self._protocol, (received,), self._counter)
                    self._rate = np.where(heard["age"] < NEVER, heard["rate"], self._rate)

    def now(self) -> int:
        """Bench time, ns."""
        return self._bus.clock.now()

    @property
    def speed(self) -> float:
        """Current largest leg rate, m/s."""
        return float(np.abs(self._rate).max())

    def wait_for_motion(self, process: Process, speed: float) -> None:
        """Wait until a leg is faster than this (m/s), brakes open."""
        end = time.monotonic() + START_S
        while not (self.mode == DriveMode.RUN and self.speed > speed):
            self.look()
            assert not gone(process.pid), process.errors
            assert time.monotonic() < end, process.errors

    def close(self) -> None:
        """Leave the bus."""
        self._bus.close()
