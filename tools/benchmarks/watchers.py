"""What watchers cost a run: runs with and without them in turn, each with all virtual.

    python -m tools.benchmarks.watchers virtual --alternations 4 --duration 20

"With" is: ten pages that read, one that never does, a hundred further connections, and malformed requests all
the time, to a `hil watch` of its own. They compute on this machine too, at the lowest priority; on other
machines they would cost less. Watchers count as free where the means of stale and skipped ticks with and
without them differ by no more than the runs without differ among each other, and no tick is lost.
"""

import argparse
import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean
from typing import Any

from drivers.child_process import start

READERS, IDLE, PAUSE_S = 10, 100, 0.01
FIGURES = ("stale_ticks", "skipped_ticks", "dropped_ticks")
_STREAM = b"GET /stream HTTP/1.1\r\nHost: localhost:%d\r\n\r\n"
_MALFORMED = (
    b"\x16\x03\x01\x00\xff" * 50 + b"\r\n\r\n",
    b"GET / HTTP/9\r\n\r\n",
    b"POST /operate HTTP/1.1\r\nHost: x\r\nContent-Length: 99999999\r\n\r\n",
    b"A" * 20000,
    b"POST /operate HTTP/1.1\r\nHost: evil\r\nContent-Length: 20\r\n\r\n" + b'{"line": "estop"}   ',
)


class Crowd:
    """All who are connected to one server. Mutable state: sockets, threads, what was read."""

    def __init__(self, port: int) -> None:
        self._port, self._going = port, True
        self.malformed = 0
        self.stamps: list[list[float]] = [[] for _ in range(READERS)]
        silent = self._open(_STREAM % port)
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self._open_ones = [silent, *(self._open(b"GET" if k % 2 else b"") for k in range(IDLE))]
        self._threads = [threading.Thread(target=self._read, args=(k,)) for k in range(READERS)]
        self._threads.append(threading.Thread(target=self._harm))
        for thread in self._threads:
            thread.start()

    def _open(self, data: bytes) -> socket.socket:
        connection = socket.create_connection(("127.0.0.1", self._port), timeout=10.0)
        connection.sendall(data)
        return connection

    def _read(self, k: int) -> None:
        _step_back()
        with self._open(_STREAM % self._port) as connection:
            connection.settimeout(0.5)
            while self._going:
                with contextlib.suppress(TimeoutError):
                    count = connection.recv(1 << 16).count(b"event: state\n")
                    self.stamps[k] += [time.monotonic()] * count

    def _harm(self) -> None:
        _step_back()
        while self._going:
            with (
                contextlib.suppress(OSError),
                self._open(_MALFORMED[self.malformed % len(_MALFORMED)]) as bad,
            ):
                bad.recv(4096)
            self.malformed += 1
            if self.malformed % 100 == 0:  # those that were idle for too long have been cut off
                for k in range(1, len(self._open_ones)):
                    self._open_ones[k].close()
                    with contextlib.suppress(OSError):
                        self._open_ones[k] = self._open(b"GET" if k % 2 else b"")
            time.sleep(PAUSE_S)

    def rate(self, k: int) -> float:
        """Return how many states a second one of the readers got, from its first to its last."""
        stamps = self.stamps[k]
        return (len(stamps) - 1) / (stamps[-1] - stamps[0]) if len(stamps) > 1 else 0.0

    def close(self) -> None:
        """Let all go."""
        self._going = False
        for thread in self._threads:
            thread.join()
        for connection in self._open_ones:
            connection.close()


def _step_back() -> None:
    """Give this thread, not the run that the process starts, the lowest priority."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)


@contextlib.contextmanager
def crowd(configuration: str) -> Iterator[Crowd]:
    """Start `hil watch` and a crowd in front of it."""
    process = start(
        "hil.cli", "watch", configuration, "--port", "0", stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        assert process.stderr is not None
        line = process.stderr.readline().decode()
        found = re.search(r":(\d+)/", line)
        if found is None:
            raise SystemExit(f"hil watch did not start: {line}")
        people = Crowd(int(found[1]))
        try:
            yield people
        finally:
            people.close()
    finally:
        process.terminate()
        process.wait()


def one_run(configuration: str, duration_s: float, folder: Path, name: str) -> dict[str, Any]:
    """Run all virtual; return the figures of its summary."""
    file = folder / f"{name}.json"
    words = ["run", configuration, "--plant", "--arm", "--duration", str(duration_s), "--json", str(file)]
    words += ["--log", str(folder / f"{name}.mcap")]
    code = start("hil.cli", *words, stdout=subprocess.DEVNULL, stdin=subprocess.DEVNULL).wait()
    if not file.exists():
        raise SystemExit(f"hil run ended with exit code {code}")
    summary = json.loads(file.read_text())
    return {
        "exit": code,
        **{each: summary[each] for each in FIGURES},
        "wake_up_us": summary.get("wake_up_us"),
    }


def main() -> int:
    """Measure and judge; return 0 where watchers cost nothing that can be seen."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("configuration", nargs="?", default="virtual")
    parser.add_argument("--alternations", type=int, default=4)
    parser.add_argument("--duration", type=float, default=20.0, metavar="S")
    given = parser.parse_args()
    results: dict[str, list[dict[str, Any]]] = {"without": [], "with": []}
    with tempfile.TemporaryDirectory() as folder:
        for k in range(given.alternations):
            for kind, found in results.items():
                name = f"{kind}-{k}"
                once = one_run if kind == "without" else run_in_front_of
                run = once(given.configuration, given.duration, Path(folder), name)
                found.append(run)
                print(f"{kind:8s}", json.dumps(run), flush=True)
    return judge(results)


def run_in_front_of(configuration: str, duration_s: float, folder: Path, name: str) -> dict[str, Any]:
    """Run with a crowd that begins before it and stays to its end."""
    with crowd(configuration) as people:
        found = one_run(configuration, duration_s, folder, name)
        rates = [round(people.rate(k), 1) for k in range(READERS)]
        return {**found, "states_per_s": [min(rates), max(rates)], "malformed": people.malformed}


def judge(results: dict[str, list[dict[str, Any]]]) -> int:
    """Print the means and the verdict; return the exit code."""
    good = all(run["dropped_ticks"] == 0 and run["exit"] == 0 for found in results.values() for run in found)
    for figure in FIGURES[:2]:
        without, those = ([run[figure] for run in results[kind]] for kind in ("without", "with"))
        spread, change = max(without) - min(without), fmean(those) - fmean(without)
        good &= change <= spread
        print(f"{figure}: without {without}, spread {spread}; with {those}, means differ by {change:+.2f}")
    print("watchers cost nothing that can be seen" if good else "watchers cost something, or a run failed")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
