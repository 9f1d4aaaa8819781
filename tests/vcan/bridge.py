"""Runs inside a kernel with vcan0: plant and controller in two processes on vcan0, with candump next to them.

``bridge.py FOLDER``: run.json, plant.json and candump.log go to FOLDER; the exit code is the controller's.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from tests.vcan.candump_log import candump

START_LIMIT_S = 60.0
STOP_LIMIT_S = 15.0


def wait_for_drives(plant: subprocess.Popen[bytes], log: Path) -> None:
    """Wait for the first frame of a drive; the controller would give up after two seconds without any."""
    deadline = time.monotonic() + START_LIMIT_S
    while not log.stat().st_size:
        if plant.poll() is not None or time.monotonic() > deadline:
            raise SystemExit(f"no drive heard from `hil plant` (exit code {plant.returncode})")
        time.sleep(0.05)


def main() -> int:
    """Run plant and controller; return the controller's exit code."""
    folder = Path(sys.argv[1])
    heard = folder / "candump.log"
    hil = [sys.executable, "-m", "hil.cli"]
    plant_command = [*hil, "plant", "vcan50", "--duration", "200", "--log", str(folder / "plant.mcap")]
    run_command = [*hil, "run", "vcan50", "--arm", "--duration", "10", "--log", str(folder / "run.mcap")]
    with candump("vcan0", heard):
        plant = subprocess.Popen(plant_command, stdin=subprocess.DEVNULL)
        try:
            wait_for_drives(plant, heard)
            run = subprocess.run([*run_command, "--json", str(folder / "run.json")], check=False)
        finally:
            plant.terminate()
            plant.wait(STOP_LIMIT_S)
    return run.returncode


if __name__ == "__main__":
    sys.exit(main())
