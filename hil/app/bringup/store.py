"""What a bring-up remembers between its runs: facts, and the hardware that they are about."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from drivers.errors import RunError
from hil.app.configuration.configuration import Configuration
from hil.app.files import write_whole
from hil.bringup.context import Finding

VERSION = 1
_WHOLE = {"absent", "same_id", "wrong_protocol", "second_controller", "set_up"}
"""Findings after which the bus is scanned again."""
_BY_LEG = ("ids", "encoder", "held", "opens", "force", "gauge", "watchdog")


class Store:
    """The state file. Mutable state: the facts, which are written at each change."""

    def __init__(self, path: Path, identity: dict[str, Any]) -> None:
        """Read what is known of the same hardware. Raises RunError for a file that is no state."""
        self.path, self._identity = path, identity
        self.facts: dict[str, dict[str, Any]] = {}
        self.changed = ""
        """What of the hardware is another than in the file; empty: nothing, or there is no file."""
        if path.exists():
            self._read()

    def _read(self) -> None:
        try:
            there = json.loads(self.path.read_text(encoding="utf-8"))
            version, identity, facts = there["version"], there["identity"], there["facts"]
        except (ValueError, KeyError, TypeError, OSError) as error:
            raise RunError(
                f"{self.path}: no state of a bring-up ({error}); remove it, or name another with --state"
            ) from None
        if version != VERSION:
            raise RunError(f"{self.path}: version {version}, allowed: {VERSION}; remove it to begin anew")
        other = [key for key, value in self._identity.items() if identity.get(key) != value]
        if other:
            self.changed = ", ".join(other)
        else:
            self.facts = facts

    def save(self) -> None:
        """Write the file."""
        there = {"version": VERSION, "identity": self._identity, "facts": self.facts}
        write_whole(self.path, json.dumps(there, indent=1) + "\n")

    def forget(self, findings: Iterable[Finding]) -> None:
        """Drop what was measured at legs that are to be mended: it is measured again."""
        for finding in findings:
            if finding.name in _WHOLE:
                self.facts.clear()
            for leg in finding.legs:
                for step in _BY_LEG:
                    self.facts.get(step, {}).pop(str(leg), None)
            self.facts.pop("mounted", None)
            self.facts.pop("passed", None)
        self.save()


def identity(c: Configuration, wiring: Iterable[str]) -> dict[str, Any]:
    """Return what a configuration says of the hardware, and of the rehearsal's wiring, as JSON values."""
    drives = c.drives.model_dump(mode="json")
    platform = c.platform.model_dump(mode="json")
    return {
        "bus": {"interface": c.bus.interface, "channel": c.bus.channel, "layout": c.bus.layout},
        "node numbers": drives.pop("node_ids"),
        "drives": drives,
        "stroke": [c.platform.length_min_m, c.platform.length_max_m],
        "joints": [platform["base_joints_m"], platform["platform_joints_m"]],
        "rehearsal": sorted(wiring),
    }
