"""State file of a bring-up between its runs: results, and the identity of the hardware they describe."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from drivers.errors import RunError
from hil.app.configuration.configuration import Configuration
from hil.app.files import write_whole
from hil.lab.bringup.context import Finding, forget_legs

VERSION = 7
_WHOLE = {"absent", "same_id", "wrong_protocol", "second_controller", "set_up"}
"""Findings after which all results are measured again."""
_STANDS = "platform"
"""Result that survives a change of hardware: the platform hangs on the legs until taken down."""


class Store:
    """The state file of a bring-up. Mutable state: the results, written at each change."""

    def __init__(self, path: Path, identity: dict[str, Any], *, again: bool = False) -> None:
        """Read the results about this hardware; again: only that the platform hangs. Raises RunError."""
        self.path, self._identity = path, identity
        self.facts: dict[str, dict[str, Any]] = {}
        self.changed = ""
        """Parts of the hardware that differ from the state file; empty: equal, or no file."""
        if path.exists():
            self._read(again=again)

    def _read(self, *, again: bool) -> None:
        try:
            there = json.loads(self.path.read_text(encoding="utf-8"))
            version, identity, facts = there["version"], there["identity"], there["facts"]
            whole = version == VERSION and there["check"] == _check(identity, facts)
        except (ValueError, KeyError, TypeError, OSError, RecursionError):
            version, whole = VERSION, False
        if not whole:
            why = "damaged, or changed by hand" if version == VERSION else f"version {version}"
            raise RunError(
                f"{self.path}: {why}, allowed: an unchanged state of version {VERSION}. It stays as it is: "
                "take the platform off the legs, then remove it or choose another with --state"
            )
        other = [key for key, value in self._identity.items() if identity.get(key) != value]
        if again or other:
            self.changed = "" if again else ", ".join(other)
            self.facts = {_STANDS: facts[_STANDS]} if _STANDS in facts else {}
        else:
            self.facts = facts

    def save(self) -> None:
        """Write the file. Raises RunError if that fails; the old content stays."""
        there = {"version": VERSION, "identity": self._identity, "facts": self.facts}
        there["check"] = _check(self._identity, self.facts)
        try:
            write_whole(self.path, json.dumps(there, indent=1) + "\n")
        except OSError as error:
            raise RunError(
                f"{self.path}: the state cannot be written ({error.strerror}). It keeps the results "
                "before the last one; free disk space or choose another with --state, and repeat the command"
            ) from None

    def forget(self, findings: Iterable[Finding]) -> None:
        """Delete the results about the legs of findings, so that they are measured again after the repair."""
        for finding in findings:
            if finding.name in _WHOLE:
                for step in self.facts.keys() - {_STANDS}:
                    del self.facts[step]
            forget_legs(self.facts, finding.legs)
        self.save()


def _check(*parts: Any) -> str:
    """SHA-256 of the file's content; protects results whose change could open a brake."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def identity(c: Configuration, wiring: Iterable[str]) -> dict[str, Any]:
    """Hardware described by a configuration, and the mistakes of a rehearsal, as JSON values."""
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
