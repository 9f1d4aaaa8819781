"""The commands that meet obstacles."""

from __future__ import annotations

from typing import NamedTuple


class Command(NamedTuple):
    """One command, short."""

    words: tuple[str, ...]
    interrupt_s: float | None = None
    """When Ctrl-C ends it; None: it ends by itself."""


_ROBOT = (
    "--base-radius", "0.3", "--platform-radius", "0.2", "--length-min", "0.4", "--stroke", "0.2",
    "--mass", "20", "--leg-mass", "2", "--drive-force", "500", "--drive-speed", "0.3",
)  # fmt: skip
COMMANDS = {
    "sim": Command(("sim", "my.yaml", "--duration", "0.3")),
    "run": Command(("run", "my.yaml", "--plant", "--arm", "--duration", "0.3")),
    "compare": Command(("compare", "my.yaml", "--laws", "pd", "--duration", "0.2", "--jobs", "1")),
    "replay": Command(("replay", "stock.mcap")),
    "check": Command(("check", "my.yaml")),
    "report": Command(("report", "stock.mcap")),
    "new": Command(("new", "new.yaml", "--yes", *_ROBOT)),
    "watch": Command(("watch", "my.yaml", "--port", "0"), interrupt_s=3.0),
    "export": Command(("export", "stock.mcap", "new.csv")),
    "plot": Command(("plot", "stock.mcap")),
    "bringup": Command(("bringup", "my.yaml", "--rehearse", "--yes")),
}
"""Name -> command."""
