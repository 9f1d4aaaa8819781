"""Runs inside a kernel with CAN: `hil adapter` on two virtual interfaces with injected latency and loss.

``adapter.py FOLDER``: writes found.json, with the kernel's own counts of dropped frames.
"""

from __future__ import annotations

import json
import sys
import threading
from importlib import resources
from pathlib import Path

from click.testing import CliRunner

from hil.app.configuration.changes import with_changes
from hil.cli import main as hil
from tests.vcan import kernel

NEAR, FAR = "hilA", "hilB"
LOSS = 0.01
DELAYS_S = {"short": (0.3e-3, 0.1e-3), "long": (3e-3, 1e-3)}


class Wire(kernel.Adapter):
    """A serial adapter that hands each frame to another one, but drops every 100th."""

    other: Wire
    frames = dropped = 0

    def sent(self, line: bytes) -> None:
        if line[:1] == b"t":
            Wire.frames += 1
            if Wire.frames % 100:
                self.other.says(line)
            else:
                Wire.dropped += 1


def serial(folder: Path) -> dict[str, object]:
    """Two serial adapters on one wire, first alone, as their driver echoes nothing."""
    one, two = Wire(1_000_000, txqueuelen=100), Wire(1_000_000, txqueuelen=100)
    one.other, two.other = two, one
    alone = measured(folder, one.name)
    both = measured(folder, one.name, "--receiver", two.name, "--duration", "1")
    for each in (one, two):
        each.close()
    return {"alone": alone, "both": both, "dropped": Wire.dropped}


def configuration(folder: Path, channel: str = NEAR) -> Path:
    text = resources.files("configs").joinpath("socketcan.yaml").read_text(encoding="utf-8")
    path = folder / "my.yaml"
    path.write_text(with_changes(text, {"bus": {"channel": channel}}))
    return path


def call(*words: str) -> tuple[int, str]:
    done = CliRunner().invoke(hil, list(words))
    return done.exit_code, done.output


def measured(folder: Path, channel: str, *words: str) -> dict[str, object]:
    code, output = call(
        "adapter", str(configuration(folder, channel)), *words, "--json", str(folder / "summary.json")
    )
    summary = json.loads((folder / "summary.json").read_text()) if code < 2 else {}
    return {"code": code, "output": output, "summary": summary}


def main() -> None:
    folder = Path(sys.argv[1])
    found: dict[str, object] = {}
    with kernel.pair(NEAR, FAR):
        found["plain"] = measured(folder, NEAR, "--receiver", FAR, "--duration", "1")
        for word, times in DELAYS_S.items():
            for name in (NEAR, FAR):
                kernel.lose(name, LOSS, *times)
            seconds = "10" if word == "short" else "1"
            watched = kernel.Watched(NEAR, FAR)
            found[word] = measured(folder, NEAR, "--receiver", FAR, "--duration", seconds)
            found[f"{word} truth"] = watched.delays_us(1000)
            found[f"{word} dropped"] = [kernel.dropped(name) for name in (NEAR, FAR)]
            found[f"{word} check"] = call("check", str(folder / "my.yaml"))
        for name in (NEAR, FAR):
            kernel.lose(name, 0.0)
        with kernel.raw_socket(FAR) as drive:
            heartbeat = threading.Timer(1.0, drive.send, [kernel.FRAME.pack(0x701, 1, b"\x05")])
            counted = kernel.sent(NEAR)
            heartbeat.start()
            found["busy"] = measured(folder, NEAR, "--receiver", FAR)
            found["busy_sent"] = kernel.sent(NEAR) - counted
    found["own"] = call("adapter", "vcan0", "--duration", "1")
    found["serial"] = serial(folder)
    (folder / "found.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main()
