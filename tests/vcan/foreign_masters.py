"""Runs inside a kernel with vcan0: `hil plant` on it, and the masters of docs/examples in their own processes.

``foreign_masters.py FOLDER``: for each family, FOLDER gets FAMILY.out (output of its master), FAMILY.json (summary of
the plant) and FAMILY.mcap (log of the plant).
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml

from tests.vcan import kernel

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs/examples"
MASTERS = {
    "cia402": ["canopen_master.py", str(ROOT / "drivers/cia402/emulated_drive.eds")],
    "moteus": ["moteus_master.py"],
}
LIMIT_S = 60.0


def configuration(folder: Path, family: str) -> Path:
    """Write a configuration: the guide's sections for the family, and our FMU without weight as the plant."""
    page = (ROOT / "docs/guides/foreign-controllers.md").read_text(encoding="utf-8")
    blocks = [yaml.safe_load(each.split("```")[0]) for each in page.split("```yaml\n")[1:]]
    (block,) = (each for each in blocks if each["drives"]["protocol"] == family)
    text: dict[str, Any] = yaml.safe_load((ROOT / "configs/bench.yaml").read_text(encoding="utf-8"))
    text["bus"] |= block["bus"] | {"interface": "socketcan", "channel": "vcan0"}
    text["drives"] |= block["drives"]
    text["loop"] |= {"rate_Hz": 50, "spin_us": 0}
    text["drives"]["watchdog_ms"] = 200
    text["plant"] = {"model": {"type": "stewart"}, "drives": text["plant"]["drives"]}
    del text["plant"]["drives"]["force_bandwidth_Hz"]
    path = folder / f"{family}.yaml"
    path.write_text(yaml.safe_dump(text), encoding="utf-8")
    return path


def moved(folder: Path, family: str) -> int:
    """Serve one family and let its master move it; return the master's exit code."""
    script, *arguments = MASTERS[family]
    hil = [sys.executable, "-m", "hil.cli", "plant", str(configuration(folder, family))]
    files = ["--log", str(folder / f"{family}.mcap"), "--json", str(folder / f"{family}.json")]
    with kernel.raw_socket("vcan0", fd=True) as listener:
        plant = subprocess.Popen([*hil, *files], stdin=subprocess.DEVNULL)
        try:
            if family == "cia402":  # a drive announces itself
                listener.settimeout(LIMIT_S)
                listener.recv(72)
            else:  # a moteus only answers
                kernel.wait_until((folder / f"{family}.mcap").exists, LIMIT_S)
            time.sleep(2.0)
            with (folder / f"{family}.out").open("w") as out:
                command = [sys.executable, str(EXAMPLES / script), *arguments, "vcan0", "socketcan"]
                done = subprocess.run(command, stdout=out, check=False, timeout=LIMIT_S)
        finally:
            plant.terminate()
            plant.wait(LIMIT_S)
    return done.returncode


def main() -> int:
    """Run the families; return the first nonzero exit code."""
    folder = Path(sys.argv[1])
    return next((code for family in MASTERS if (code := moved(folder, family))), 0)


if __name__ == "__main__":
    sys.exit(main())
