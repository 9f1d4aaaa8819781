"""Consent of the operator: Enter in a real terminal, and a run that waits for it."""

from __future__ import annotations

import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.errors import RunError
from hil.app.run.command import EnterKey
from hil.cli import main
from tests.broad import broad

ROOT = Path(__file__).resolve().parents[3]
IN_A_TERMINAL = """
import time
from hil.app.run.command import EnterKey
key = EnterKey(lambda: print("gone", flush=True))
time.sleep(0.2)
print("first", key.pressed(), flush=True)
end = time.monotonic() + 10
while time.monotonic() < end and not key.pressed():
    time.sleep(0.01)
print("pressed", time.monotonic() < end, flush=True)
"""


def read_until(terminal: int, word: bytes) -> bytes:
    heard, end = b"", time.monotonic() + 60.0
    while word not in heard and time.monotonic() < end:
        if select.select([terminal], [], [], 0.1)[0]:
            heard += os.read(terminal, 1024)
    return heard


def test_enter_on_the_terminal_arms_only_if_pressed_after_the_drives_are_ready():
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(ROOT)
        os.execv(sys.executable, [sys.executable, "-c", IN_A_TERMINAL])
    try:
        os.write(terminal, b"\n\n")
        assert b"first False" in read_until(terminal, b"first False")
        os.write(terminal, b"x")
        time.sleep(0.1)
        os.write(terminal, b"\n")
        assert b"pressed True" in read_until(terminal, b"pressed True")
    finally:
        os.waitpid(pid, 0)
        os.close(terminal)


AT_A_TERMINAL_THAT_GOES = """
import signal, sys, time
from hil.app.run.command import _hung_up
from hil.app.run.command import EnterKey
from hil.cli import main
from hil.loop.panel import OperatorPanel
signal.signal(signal.SIGHUP, signal.SIG_IGN)
panel = OperatorPanel()
told = []
def gone():
    told.append(1)
    _hung_up(panel)
key = EnterKey(gone)
panel.running()
if sys.argv[2] == "asked":
    key.pressed()
print("ready", flush=True)
end = time.monotonic() + 30
while time.monotonic() < end and not told:
    assert not key.pressed()
    time.sleep(0.01)
signal.raise_signal(signal.SIGHUP)
again = [key.pressed() for _ in range(3)]
with open(sys.argv[1], "w") as file:
    print(len(told), again, [c.name for c in panel.take()], file=file)
"""


@pytest.mark.parametrize("asked", broad(["asked", "at once"], quick=1))
def test_closing_the_terminal_causes_one_controlled_stop(tmp_path, asked):
    """Reading from it fails or returns no bytes; SIGHUP may follow."""
    said = tmp_path / "said"
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(ROOT)
        os.execv(sys.executable, [sys.executable, "-c", AT_A_TERMINAL_THAT_GOES, str(said), asked])
    assert b"ready" in read_until(terminal, b"\n")
    os.close(terminal)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert said.read_text() == "1 [False, False, False] ['STOP']\n"


def test_run_without_a_terminal_requires_the_option_arm(tmp_path):
    with (tmp_path / "input").open("w+") as file, pytest.raises(RunError, match="--arm"):
        EnterKey(lambda: None, file.fileno())


def test_hil_run_without_consent_ends_before_it_opens_the_bus():
    ended = subprocess.run(
        [sys.executable, "-m", "hil.cli", "run", "virtual", "--plant"],
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 2
    assert "add --arm" in ended.stderr


def test_options_arm_and_wait_for_arm_exclude_each_other():
    result = CliRunner().invoke(main, ["run", "virtual", "--arm", "--wait-for-arm"])
    assert result.exit_code == 2
    assert "--arm and --wait-for-arm contradict each other" in result.stderr
