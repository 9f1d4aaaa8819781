"""Runs inside a kernel with vcan0: `hil bus` with CAN FMUs, and a raw socket of the kernel as another node.

``can_fmus.py FOLDER``: runs each line of FOLDER/runs.json, a list {name: arguments of `hil bus`}. The summary goes
to NAME.json, what the socket received to NAME.frames, a frame a line: time s, struct can(fd)_frame as hexadecimal.
"""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

from tests.vcan import kernel

FOREIGN = struct.pack("=IB3x8s", 0x300, 1, b"\x07")


def run(folder: Path, name: str, arguments: list[str]) -> None:
    """One run; the other node sends one frame as soon as it hears one."""
    with kernel.raw_socket("vcan0", fd=True) as other:
        other.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        summary = folder / f"{name}.json"
        command = [sys.executable, "-m", "hil.cli", "bus", *arguments, "--json", str(summary)]
        process = subprocess.Popen([*command, "--interface", "socketcan", "--channel", "vcan0"])
        lines = list[str]()
        while process.poll() is None:
            for frame in kernel.heard(other, 0.2):
                if not lines:
                    other.send(FOREIGN)
                lines.append(f"{time.monotonic():.6f} {frame.hex()}")
        (folder / f"{name}.frames").write_text("\n".join(lines))


def main() -> None:
    """Run all."""
    folder = Path(sys.argv[1])
    for name, arguments in json.loads((folder / "runs.json").read_text()).items():
        run(folder, name, arguments)


if __name__ == "__main__":
    main()
