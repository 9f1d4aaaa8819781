"""What a bring-up remembers between its runs: facts, and the hardware that they are about."""

import json
from collections.abc import Iterable
from math import isfinite
from pathlib import Path
from typing import Any

from drivers.errors import RunError
from drivers.signals import LEGS
from hil.app.configuration.configuration import Configuration
from hil.app.files import write_whole
from hil.lab.bringup.context import Finding
from hil.lab.bringup.facts import forget_legs

VERSION = 5
_WHOLE = {"absent", "same_id", "wrong_protocol", "second_controller", "set_up"}
"""Findings after which the bus is scanned again."""
_STANDS = ("platform",)
"""Facts that hold whatever was exchanged: the platform hangs on the legs until somebody takes it down."""


class Store:
    """The state file. Mutable state: the facts, which are written at each change."""

    def __init__(self, path: Path, identity: dict[str, Any], *, again: bool = False) -> None:
        """Read what is known of the same hardware; again: only whether the platform hangs on the legs.

        Raises RunError for a file that is no state: it stays as it is.
        """
        self.path, self._identity = path, identity
        self.facts: dict[str, dict[str, Any]] = {}
        self.changed = ""
        """What of the hardware is another than in the file; empty: nothing, or there is no file."""
        if path.exists():
            self._read(again=again)

    def _read(self, *, again: bool) -> None:
        try:
            there = json.loads(self.path.read_text(encoding="utf-8"))
            version, identity, facts = there["version"], dict(there["identity"]), there["facts"]
            if version == VERSION:
                refuse_malformed(facts)
        except (ValueError, KeyError, TypeError, OSError, RecursionError) as error:
            raise RunError(
                f"{self.path}: no state of a bring-up ({type(error).__name__}: {error}). It stays as it "
                "is: name another with --state, or remove it, and take the platform off the legs before"
            ) from None
        if version != VERSION:
            raise RunError(
                f"{self.path}: version {version}, allowed: {VERSION}; take the platform off, and remove it"
            )
        other = [key for key, value in self._identity.items() if identity.get(key) != value]
        if again or other:
            self.changed = "" if again else ", ".join(other)
            self.facts = {key: facts[key] for key in _STANDS if key in facts}
        else:
            self.facts = facts

    def save(self) -> None:
        """Write the file. Raises RunError where it cannot be written: what it held before stays."""
        there = {"version": VERSION, "identity": self._identity, "facts": self.facts}
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
                for step in self.facts.keys() - set(_STANDS):
                    del self.facts[step]
            forget_legs(self.facts, finding.legs)
        self.save()

    def forget_brakes(self) -> None:
        """Drop that brakes hold and open, and that steps have passed: brakes are tested again."""
        for step in ("held", "opens", "passed"):
            self.facts.pop(step, None)
        self.save()


def refuse_malformed(facts: Any) -> None:
    """Raise ValueError or TypeError for facts that no step has written: another shape or type."""
    if not isinstance(facts, dict):
        raise TypeError("facts are no table")
    for step, table in facts.items():
        keys = _FORMS.get(step)
        if keys is None or not isinstance(table, dict):
            raise ValueError(f"facts of {step!r}")
        for name, fact in table.items():
            known = _NAMES.get(step, _LEG_NAMES)
            if (known and name not in known) or not _fits(fact, keys.get(name, keys.get(""))):
                raise ValueError(f"fact {name!r} of {step!r}")


def _fits(value: Any, form: Any) -> bool:
    """Tell whether a value has a form: types, values, a list of so many, a table of keys, or of any."""
    if isinstance(form, dict) and _ANY in form:
        return isinstance(value, dict) and all(_fits(each, form[_ANY]) for each in value.values())
    if isinstance(form, dict):
        return isinstance(value, dict) and all(key in value and _fits(value[key], form[key]) for key in form)
    if isinstance(form, frozenset):
        return isinstance(value, (int, type(None))) and not isinstance(value, bool) and value in form
    if isinstance(form, list):
        many = (len(value) == form[1] if form[1] else True) if isinstance(value, list) else False
        return many and all(_fits(each, form[0]) for each in value)
    if isinstance(value, bool) and bool not in form:
        return False
    return isinstance(value, form) and (not isinstance(value, float) or isfinite(value))


_LEG_NAMES = frozenset(map(str, range(LEGS)))
_NAMES: dict[str, frozenset[str]] = {
    "scan": _LEG_NAMES | {"bus"},
    "mounted": frozenset(("0", "1")),
    "load": frozenset(("mass_kg", "presses")),
    "passed": frozenset(),
    "platform": frozenset(("hung",)),
}
"""Names of the facts of a step, where they are not the legs; empty: any."""
_NUMBER, _MAYBE, _FLAG, _TEXT = (int, float), (int, float, type(None)), (bool,), (str,)
_LEG, _WAYS = frozenset(range(LEGS)), frozenset((-1, 0, 1))
_LEGS, _LEG_OR_NONE = [_LEG, 0], _LEG | {None}
_ANY = "*"
"""In place of the keys of a table: whatever they are."""
_WAY = {"force_N": _MAYBE, "leg": _LEG_OR_NONE, "way": _WAYS}
_FORMS: dict[str, dict[str, Any]] = {
    "scan": {
        "": {
            "answers": _NUMBER,
            "twice": _FLAG,
            "state": _TEXT,
            "lacks": _TEXT,
            "fault": _TEXT,
            "spoken": [(int,), 0],
        },
        "bus": {"foreign": (int,), "refused": (int,), "strange": [(int,), 0]},
    },
    "identity": {"": {_ANY: (int,)}},
    "watchdog": {"": {"powered": _FLAG, "until_s": _MAYBE, "since_s": _MAYBE}},
    "ids": {"": {"drives": _LEGS, "changes_m": [_NUMBER, LEGS]}},
    "encoder": {
        "": {
            "drive": _LEG_OR_NONE,
            "tape_m": [_NUMBER, 2],
            "scale": _NUMBER,
            "offset_m": _NUMBER,
            "bent_m": _NUMBER,
        }
    },
    "held": {"": {"moved": _FLAG, "hand_N": _MAYBE}},
    "opens": {"": {"legs": _LEGS, "hand_N": _MAYBE, "rate_share": _MAYBE}},
    "force": {"": {"plus": _WAY, "minus": _WAY}},
    "gauge": {"": {"pairs_N": [[_NUMBER, 2], 0]}},
    "mounted": {"": {"q_m": [_NUMBER, LEGS]}},
    "load": {"": _NUMBER},
    "passed": {"": _FLAG},
    "platform": {"": _FLAG},
}
"""What each step keeps, by the name of the fact; empty: all others."""


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
