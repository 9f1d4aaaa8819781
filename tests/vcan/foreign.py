"""Runs where vcan0 exists: `hil plant` on it, and the masters of docs/examples in processes of their own.

``foreign.py FOLDER``: for each family FAMILY.out, what its master printed, FAMILY.json, the plant's summary, and
FAMILY.mcap, its log, go to FOLDER. Where FOLDER has the FMU of `tests.foreign_plant` that is behind the drives of cia402
alone, and cia402.read is the position that canopen reads of the leg when its master has gone.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import can
import canopen
import yaml

from hil.app.configuration.changes import with_changes
from tests import foreign_plant
from tests.vcan import kernel

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "docs/examples"
MASTERS = {
    "cia402": ["canopen_master.py", str(ROOT / "drivers/cia402/emulated_drive.eds")],
    "moteus": ["moteus_master.py"],
}
LIMIT_S = 60.0
FMU = "PythonPlant.fmu"


def configuration(folder: Path, family: str) -> Path:
    """Write a configuration: the section of the page for the family, our FMU without weight behind the drives."""
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
    written, fmu = yaml.safe_dump(text), folder / FMU
    if fmu.exists():
        changes = foreign_plant.sections(fmu)
        changes["plant"]["model"]["step_us"] = 5000  # system calls take ten times as long there
        written = with_changes(written, changes)
    path = folder / f"{family}.yaml"
    path.write_text(written, encoding="utf-8")
    return path


def moved(folder: Path, family: str) -> int:
    """Serve one family and let its master move it; return the master's exit code."""
    script, *arguments = MASTERS[family]
    hil = [sys.executable, "-m", "hil.cli", "plant", str(configuration(folder, family))]
    files = ["--log", str(folder / f"{family}.mcap"), "--json", str(folder / f"{family}.json")]
    with kernel.raw_socket("vcan0", fd=True) as listener:
        plant = subprocess.Popen([*hil, *files], stdin=subprocess.DEVNULL)
        try:
            if family == "cia402":  # a drive says by itself that it is there
                listener.settimeout(LIMIT_S)
                listener.recv(72)
            else:  # a moteus speaks when it is asked
                kernel.wait_until((folder / f"{family}.mcap").exists, LIMIT_S)
            time.sleep(2.0)
            with (folder / f"{family}.out").open("w") as out:
                command = [sys.executable, str(EXAMPLES / script), *arguments, "vcan0", "socketcan"]
                done = subprocess.run(command, stdout=out, check=False, timeout=LIMIT_S)
            if (folder / FMU).exists():
                (folder / f"{family}.read").write_text(f"{position()}")
        finally:
            plant.terminate()
            plant.wait(LIMIT_S)
    return done.returncode


def position() -> int:
    """Return 0x6064 of drive 5 as canopen reads it, latched by a SYNC of its own."""
    network = canopen.Network(bus=can.Bus("vcan0", "socketcan", ignore_config=True))
    network.connect()
    network.sync.transmit()
    time.sleep(0.5)
    counts = network.add_node(5, MASTERS["cia402"][1]).sdo[0x6064].raw
    network.disconnect()
    return int(counts)


def main() -> int:
    """Run the families; return the first exit code that is none."""
    folder = Path(sys.argv[1])
    families = ("cia402",) if (folder / FMU).exists() else MASTERS
    return next((code for family in families if (code := moved(folder, family))), 0)


if __name__ == "__main__":
    sys.exit(main())
