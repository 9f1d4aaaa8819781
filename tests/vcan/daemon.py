"""Runs inside a kernel with CAN: `hil plant` and `hil run` at the two ends of a wire that fails.

``daemon.py SCENARIO FOLDER``: run.json, run.mcap and found.json go to FOLDER. One of SCENARIOS acts while the
daemon runs. The daemon's exit code is left to the test, since it ends after faults.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import yaml

from drivers.errors import RunError
from hil.operate.client import OperatorClient
from tests.vcan import kernel
from tests.vcan.kernel import FRAME

NEAR, FAR = "hilA", "hilB"
ROOT = Path(__file__).resolve().parents[2]
ERROR = 0x20000000
START_LIMIT_S, MODE_LIMIT_S = 60.0, 20.0
PATIENT_TICKS = 100
ATTEMPTS = 3
SLOW = {"axis": "z_m", "amplitude": 0.02, "frequency_Hz": 0.1}
LOSS_S, LOSS = 60.0, 0.01
Found = dict[str, Any]


def configuration(folder: Path, channel: str) -> Path:
    """Write the configuration of a run at 50 Hz that stays after faults, slowly along its path.

    A busy machine may stall this kernel for half a second. Six legs on springs survive that where a platform
    would fall, so that only the bus causes faults.
    """
    text = yaml.safe_load((ROOT / "configs/bench.yaml").read_text())
    text["bus"] |= {"interface": "socketcan", "channel": channel, "layout": "classic"}
    text["loop"] |= {"rate_Hz": 50, "spin_us": 0}
    text["controller"] |= {"kp_N_m": 5000, "kv_N_s_m": 2000}
    text["operator"] = {"stays": True}
    text["reference"] |= {"duration_s": 300, "components": [SLOW]}
    patience = {"stale_fault_ticks": PATIENT_TICKS, "missed_stop_ticks": PATIENT_TICKS}
    text["limits"] |= {"following_error_m": 0.1, "following_error_s": 1.0, **patience}
    text["drives"]["watchdog_ms"] = 20 * PATIENT_TICKS
    path = folder / f"{channel}.yaml"
    path.write_text(yaml.safe_dump(text))
    return path


class Run:
    """A daemon on one interface, its plant on another, and the operator's channel."""

    def __init__(self, folder: Path, near: str, far: str) -> None:
        self.folder = folder
        hil = [sys.executable, "-m", "hil.cli"]
        with kernel.raw_socket(far) as listener:
            plant = [*hil, "plant", str(configuration(folder, far)), "--log", str(folder / "plant.mcap")]
            self.plant = subprocess.Popen(plant, stdin=subprocess.DEVNULL)
            # a drive announces itself; the listener waits for that frame
            listener.settimeout(START_LIMIT_S)
            listener.recv(72)
        log, summary = folder / "run.mcap", folder / "run.json"
        run = [*hil, "run", str(configuration(folder, near)), "--wait-for-arm"]
        self.run = subprocess.Popen(
            [*run, "--log", str(log), "--json", str(summary)], stdin=subprocess.DEVNULL
        )
        end = time.monotonic() + START_LIMIT_S
        while True:
            with contextlib.suppress(RunError):
                self.operator = OperatorClient("socketcan", near)
                break
            assert time.monotonic() < end, "no operator channel"
            time.sleep(0.1)
        self.reach("IDLE", limit_s=START_LIMIT_S)

    def reach(self, *modes: str, limit_s: float = MODE_LIMIT_S) -> dict[str, Any]:
        """Wait for one of these modes. Raises AssertionError at the time limit."""
        end = time.monotonic() + limit_s
        while True:
            status: dict[str, Any] = {"mode": "silent", "faults": []}
            with contextlib.suppress(RunError):  # it begins, or this machine stalls
                status = self.operator.status()
            if status["mode"] in modes:
                return status
            assert self.run.poll() is None, f"the run ended with {self.run.returncode}"
            assert time.monotonic() < end, f"{status['mode']} {status['faults']}, not {modes}"
            time.sleep(0.02)

    def arm(self) -> None:
        """Arm; repeat if this machine stalled meanwhile."""
        for _ in range(ATTEMPTS):
            self.reach("IDLE")
            answer = self.operator.arm()
            assert answer, answer.why
            if self.reach("TRACKING", "FAULT", "PARKED")["mode"] == "TRACKING":
                return
            self.operator.reset()
        raise AssertionError(f"not TRACKING in {ATTEMPTS} attempts")

    def recover(self) -> None:
        """Reset and arm again, as an operator would after a fault."""
        answer = self.operator.reset()
        assert answer, answer.why
        self.arm()

    def close(self) -> int:
        with contextlib.suppress(RunError):
            self.operator.end()
        try:
            self.run.wait(60.0)
        finally:
            for process in (self.run, self.plant):
                process.terminate()
                process.wait(20.0)
        return self.run.returncode


@contextlib.contextmanager
def running(folder: Path, near: str, far: str) -> Iterator[Run]:
    run = Run(folder, near, far)
    try:
        yield run
    finally:
        run.close()


def recovery(folder: Path) -> Found:
    """A bus that goes off, goes down, is deleted and gets a second controller, one after the other."""
    found: Found = {}
    with kernel.pair(NEAR, FAR), running(folder, NEAR, FAR) as run:
        run.arm()
        with kernel.raw_socket(FAR) as another:
            another.send(FRAME.pack(ERROR | 0x040, 8, bytes(8)))
            found["bus-off"] = run.reach("FAULT")["faults"]
            run.recover()
            kernel.up(NEAR, on=False)
            found["down"] = run.reach("FAULT")["faults"]
            kernel.up(NEAR)
            run.recover()
        kernel.delete(NEAR)
        found["deleted"] = run.reach("FAULT")["faults"]
        kernel.make_pair(NEAR, FAR)
        run.recover()
        with kernel.raw_socket(FAR) as another:
            # SYNC of another controller, which counts by itself
            for n in range(20):
                another.send(FRAME.pack(0x080, 1, bytes([7 * n & 0xF])))
                time.sleep(0.013)
            found["second"] = run.reach("FAULT")["faults"]
        run.recover()
    return found


def loss(folder: Path) -> Found:
    """Lose a share of all frames, both ways, for a minute."""
    with kernel.pair(NEAR, FAR):
        # each end receives its own frames before the queue, and the other's after it
        count = {name: Tally(name) for name in (NEAR, FAR)}
        with running(folder, NEAR, FAR) as run:
            run.arm()
            for name in (NEAR, FAR):
                kernel.lose(name, LOSS)
            modes = set()
            end = time.monotonic() + LOSS_S
            while time.monotonic() < end:
                with contextlib.suppress(RunError):
                    modes.add(run.operator.status()["mode"])
                time.sleep(0.5)
            dropped = {name: kernel.dropped(name) for name in (NEAR, FAR)}
            for name in (NEAR, FAR):
                kernel.lose(name, 0.0)
        heard = {name: tally.close() for name, tally in count.items()}
    return {"modes": sorted(modes), "dropped": dropped, "heard": heard}


class Tally(threading.Thread):
    """Counts the frames received on an interface, by identifier."""

    def __init__(self, name: str) -> None:
        super().__init__(daemon=True)
        self.sock = kernel.raw_socket(name)
        self.sock.setsockopt(socket.SOL_SOCKET, kernel.SO_RCVBUFFORCE, 1 << 24)
        self.count: dict[int, int] = {}
        self.ends = False
        self.start()

    def run(self) -> None:
        while not self.ends:
            with contextlib.suppress(TimeoutError):
                (identifier,) = FRAME.unpack(self.sock.recv(72))[:1]
                self.count[identifier] = self.count.get(identifier, 0) + 1

    def close(self) -> dict[int, int]:
        self.ends = True
        self.join()
        self.sock.close()
        return self.count


class Bridge(kernel.Adapter):
    """An adapter connected to an interface of the kernel."""

    def __init__(self, bitrate: int, name: str) -> None:
        self.wire = kernel.raw_socket(name)
        super().__init__(bitrate, txqueuelen=100)
        self.back = threading.Thread(target=self._forward, daemon=True)
        self.back.start()

    def sent(self, line: bytes) -> None:
        if line[:1] == b"t":
            length = int(line[4:5])
            data = bytes.fromhex(line[5 : 5 + 2 * length].decode())
            self.wire.send(FRAME.pack(int(line[1:4], 16), length, data))

    def _forward(self) -> None:
        while not self._stop:
            with contextlib.suppress(OSError):  # quiet for a while, or closed
                word, length, data = FRAME.unpack(self.wire.recv(16))
                self.says(b"t%03X%d%s" % (word, length, data[:length].hex().encode()))


def states(folder: Path) -> Found:
    """Take the adapter's CAN controller through warning and passive to bus-off and back, twice."""
    found: Found = {"faults": [], "kept": []}
    with kernel.pair(FAR, NEAR):
        adapter = Bridge(1_000_000, NEAR)
        with running(folder, adapter.name, FAR) as run:
            run.arm()
            for _ in range(2):
                for line in (b"sw100000", b"sp130000", b"sa000000", b"sw100000", b"sp140000"):
                    adapter.says(line)
                    time.sleep(0.2)
                    found["kept"].append(run.operator.status()["mode"])
                adapter.says(b"sb256000")
                found["faults"].append(run.reach("FAULT")["faults"])
                run.recover()
        adapter.close()
    return found


SCENARIOS: dict[str, Callable[[Path], Found]] = {f.__name__: f for f in (recovery, loss, states)}


def main() -> None:
    folder = Path(sys.argv[2])
    (folder / "found.json").write_text(json.dumps(SCENARIOS[sys.argv[1]](folder)))


if __name__ == "__main__":
    main()
