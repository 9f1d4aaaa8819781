"""A displayed run: rows of a simulation in a mirror at their own pace, and a controller's operator socket."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import numpy as np

from drivers.child_process import start
from hil.app.configuration.configuration import Configuration, load
from hil.app.watch.state import run_description
from hil.operate.client import socket_path
from hil.record.environment import product_version
from hil.record.mirror import FIGURES, Mirror, mirror_path
from hil.record.row import TICKS, describe

BOOT_NS = 5_000_000_000_000
"""Time of tick 0 on the clock of the machine."""
BUS = "localcan", "hil0"
EVENTS = [
    {"number": 1, "t_ns": BOOT_NS + 5_000_000, "level": "info", "text": "<b>begun</b>"},
    {"number": 2, "t_ns": BOOT_NS + 9_000_000, "level": "error", "text": 'it broke\n{"fault": "DRIVE"}'},
]


class LiveRun:
    """Shows rows (n,) of dtype ROW every 20 ms as if they were recorded now; after the last, it stays."""

    def __init__(self, rows: Any, name: str = "virtual") -> None:
        about = run_description(load("virtual"), Path("runs/x.mcap"), 1000.0, 20.0)
        about |= {"name": name, "version": product_version(), "columns": describe(TICKS.columns)}
        self.mirror = Mirror(mirror_path(*BUS), about)
        self._rows, self._going = rows.copy(), True
        self._rows["t_ns"] += BOOT_NS
        self.shown = 0
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self) -> None:
        figures = np.zeros((), FIGURES)
        figures["capacity"] = 8192
        begun = time.monotonic()
        while self._going:
            k = min(round(1e3 * (time.monotonic() - begun)), len(self._rows) - 1)
            figures["seen_ns"], figures["ticks"] = time.monotonic_ns(), k
            self.mirror.write(self._rows[k], figures, json.dumps(EVENTS).encode())
            self.shown += 1
            time.sleep(max(0.0, begun + 0.02 * self.shown - time.monotonic()))

    def freeze(self) -> None:
        """Stop the display, like a recorder that was killed."""
        self._going = False
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.freeze()
        self.mirror.close()


class Listening:
    """Receives the operator's lines in place of a controller, and accepts all."""

    def __init__(self, waits: str = "waits for tests", status: dict[str, Any] | None = None) -> None:
        """status: keys that differ from those of a controller that moves."""
        self._status = {"waits_for": waits, "speed_percent": 40, "speed_now_percent": 55.0, "key": "missing"}
        self._status |= status or {}
        self.lines: list[str] = []
        self.times: list[float] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.bind(str(socket_path(*BUS)))
        self._socket.listen(64)
        self._ready = select.epoll()
        self._ready.register(self._socket)
        self._clients: dict[int, socket.socket] = {}
        self._going = True
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while self._going:
            for number, _ in self._ready.poll(0.1):
                self._hear(number)

    def _hear(self, number: int) -> None:
        if number == self._socket.fileno():
            client, _ = self._socket.accept()
            self._clients[client.fileno()] = client
            self._ready.register(client, select.EPOLLIN)
            return
        with suppress(ConnectionResetError):  # it did not wait for its answers
            data = self._clients[number].recv(4096)
            if not data:
                self._clients.pop(number).close()
                return
            tag, _, line = data.decode().partition(" ")
            answer = "taken"
            if line == "status":
                answer = json.dumps(self._status)
            else:
                self.lines.append(line)
                self.times.append(time.monotonic())
            if line != "key":
                with suppress(OSError):
                    self._clients[number].send(f"{tag} {answer}".encode())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._going = False
        self._thread.join()
        for client in self._clients.values():
            client.close()
        self._ready.close()
        self._socket.close()
        socket_path(*BUS).unlink()


class Watch:
    """`hil watch` as a process. `link` is the printed address, `base` its origin."""

    def __init__(self, configuration: str, *options: str) -> None:
        self.process = start(
            "hil.cli",
            "watch",
            configuration,
            "--port",
            "0",
            *options,
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self.process.stderr is not None
        line = self.process.stderr.readline().decode()
        assert "watch at http://" in line, line
        self.link = line.split()[-1]
        self.base = self.link.partition("/?")[0].rstrip("/")
        self.port = int(self.base.rpartition(":")[2])
        self.token = self.link.partition("token=")[2]

    @property
    def resident_kB(self) -> int:
        """Memory of the process."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") // 1024

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.communicate(timeout=60.0)  # its priority is low


def operating(folder: Path) -> str:
    """Path of a configuration whose page may operate."""
    text = load("virtual").text
    path = folder / "operating.yaml"
    path.write_text(f"{text}\nwatch:\n  operate: true\n")
    found: Configuration = load(path)
    assert found.watch.operate
    return str(path)
