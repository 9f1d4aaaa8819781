"""Operator channel of a run in real time: loss of the key's holder, and emergency stop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import RunError
from drivers.signals import Fault, Mode
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.operate.client import OperatorClient
from hil.record.log import Log
from hil.signals import Operator
from tests.realtime.rig import CHANNEL, LASTING, ROOT, START_S, Listener, Process, configuration

pytestmark = pytest.mark.realtime(patient=True)

Start = Callable[..., Process]
DEADMAN = LASTING | {"\nreference: ": "\noperator: {deadman_s: 0.1}\n\nreference: "}
HOLDER = """
import sys, time
from hil.operate.client import OperatorClient
client = OperatorClient("localcan", sys.argv[1])
print("held", flush=True)
while True:
    client.key()
    time.sleep(0.01)
"""


def connected(run: Process) -> OperatorClient:
    end = time.monotonic() + START_S
    while time.monotonic() < end:
        try:
            return OperatorClient("localcan", CHANNEL)
        except RunError:
            assert run._process.poll() is None, run.errors
            time.sleep(0.05)
    raise AssertionError(run.errors)


def wait_until(client: OperatorClient, true: Callable[[dict[str, Any]], bool]) -> None:
    end = time.monotonic() + START_S
    while not true(client.status()):
        assert time.monotonic() < end, client.status()
        time.sleep(0.05)


@pytest.fixture
def holder() -> Iterator[Callable[[], subprocess.Popen[str]]]:
    """A function that starts a process holding the key."""
    started: list[subprocess.Popen[str]] = []

    def begin() -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", HOLDER, CHANNEL], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        return process

    yield begin
    for process in started:
        process.kill()
        process.wait(10)
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.long
@pytest.mark.parametrize("end", [signal.SIGSTOP, signal.SIGKILL])
def test_enabling_key_is_released_if_the_operator_process_that_holds_it_is_killed_or_stopped(
    tmp_path: Path, start: Start, holder: Callable[[], subprocess.Popen[str]], end: signal.Signals
) -> None:
    file = configuration(tmp_path, DEADMAN)
    run = start("run", str(file), "--plant")
    with connected(run) as client:
        key = holder()
        wait_until(client, lambda s: s["mode"] in {"APPROACH", "TRACKING"})
        client.start()
        wait_until(client, lambda s: s["mode"] == "TRACKING" and s["path_s"] > 0.3)
        os.kill(key.pid, end)
        wait_until(client, lambda s: s["speed_now_percent"] == 0.0)
        assert client.status()["key"] == "missing"
        assert not client.start()
        assert client.stop()

    code, summary = run.wait(), run.summary
    assert (code, summary["success"]) == (0, True), summary["trouble"]
    assert summary["replay"]["exact"]
    log = Log.open(summary["log"])
    rows = log.rows()
    last = max(
        int(tick.row["tick"]) for tick in log.ticks() if any(o.command is Operator.KEY for o in tick.orders)
    )
    ticks, t = rows["tick"], rows["reference_time_s"]
    period_s = 1.0 / summary["rate_Hz"]
    along = np.diff(t) / (np.diff(ticks) * period_s)
    slower = ticks[1:][(ticks[1:] > last) & (along < 1.0 - 1e-6)]
    assert (int(slower[0]) - 1 - last) * period_s <= 0.1 + 2 * period_s
    assert (rows["mode"][ticks == slower[0]] == Mode.TRACKING).all()


def test_emergency_stop_of_the_operator_is_on_the_bus_within_two_periods(
    tmp_path: Path, start: Start, listen: Callable[[Path], Listener]
) -> None:
    file = configuration(tmp_path, LASTING)
    run = start("run", str(file), "--plant")
    with connected(run) as client:
        wait_until(client, lambda s: s["mode"] == "TRACKING" and s["path_s"] > 0.3)
        listener = listen(file)
        said_ns = listener.now()
        assert client.estop()

    code, summary = run.wait(), run.summary
    assert code == 1
    assert summary["faults"] == [Fault.ESTOP.name]
    assert summary["replay"]["exact"]
    log = Log.open(summary["log"])
    (heard,) = [tick for tick in log.ticks() if Operator.ESTOP in tick.operator]
    period_ns = 1e9 / summary["rate_Hz"]
    # a tick takes commands until its feedback is in, so it may have begun before the command
    assert -period_ns < heard.row["t_ns"] - said_ns <= 2 * period_ns
    protocol = build_protocol(load(str(file)))
    assert set(protocol.traits.emergency_stop) <= set(heard.sent), "in the same tick"
    rows = log.rows()
    after = rows[rows["tick"] >= heard.row["tick"]]
    assert (after["faults"] == Fault.ESTOP).all()
    assert not after["tau"].any()
