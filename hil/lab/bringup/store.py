"""What a bring-up remembers between its runs: facts, and the hardware that they are about."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from drivers.errors import RunError
from hil.app.configuration.configuration import Configuration
from hil.app.files import write_whole
from hil.lab.bringup.context import Finding, forget_legs

VERSION = 6
_WHOLE = {"absent", "same_id", "wrong_protocol", "second_controller", "set_up"}
"""Findings after which the bus is scanned again."""
_STANDS = "platform"
"""Fact that holds whatever was exchanged: the platform hangs on the legs until somebody takes it down."""


class Store:
    """The state file. Mutable state: the facts, which are written at each change."""

    def __init__(self, path: Path, identity: dict[str, Any], *, again: bool = False) -> None:
        """Read what is known of this hardware; again: only whether the platform hangs. Raises RunError."""
        self.path, self._identity = path, identity
        self.facts: dict[str, dict[str, Any]] = {}
        self.changed = ""
        """What of the hardware is another than in the file; empty: nothing, or there is no file."""
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
                f"{self.path}: {why}, allowed: a state as version {VERSION} has written it. It stays as it "
                "is: take the platform off the legs, and remove it or name another with --state"
            )
        other = [key for key, value in self._identity.items() if identity.get(key) != value]
        if again or other:
            self.changed = "" if again else ", ".join(other)
            self.facts = {_STANDS: facts[_STANDS]} if _STANDS in facts else {}
        else:
            self.facts = facts

    def save(self) -> None:
        """Write the file. Raises RunError where it cannot be written: what it held before stays."""
        there = {"version": VERSION, "identity": self._identity, "facts": self.facts}
        there["check"] = _check(self._identity, self.facts)
        try:
            write_whole(self.path, json.dumps(there, indent=1) + "\n")
        except OSError as error:
            raise RunError(
                f"{self.path}: the state cannot be written ({error.strerror}). It keeps what was found "
                "before the last fact; make room, or name another with --state, and give the command again"
            ) from None

    def forget(self, findings: Iterable[Finding]) -> None:
        """Drop what was measured at legs that are to be mended: it is measured again."""
        for finding in findings:
            if finding.name in _WHOLE:
                for step in self.facts.keys() - {_STANDS}:
                    del self.facts[step]
            forget_legs(self.facts, finding.legs)
        self.save()

    def forget_brakes(self) -> None:
        """Drop that brakes hold and open, and that steps have passed: brakes are tested again."""
        for step in ("held", "opens", "passed"):
            self.facts.pop(step, None)
        self.save()


def _check(*parts: Any) -> str:
    """Return a sum over what the file holds: a digit that was changed may open a brake."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


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
