"""Proposal of a section `plant.model` for an FMU: variables that look like forces, lengths, rates, brakes.

Only the description is read; no code of the FMU is loaded.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.errors import PlantError
from plant_fmu.fmu.check import FLOATS, SWITCHES, described, library, stated_unit

_ROLES = {
    "brake": ("input", None, ("brake", "lock", "clamp", "hold")),
    "force": ("input", "N", ("force", "f", "tau", "effort", "thrust", "u")),
    "rate": (
        "output",
        "m/s",
        ("rate", "velocity", "vel", "speed", "v", "dq", "qd", "der_q", "dl", "ldot", "qdot"),
    ),
    "length": ("output", "m", ("length", "position", "pos", "len", "q", "l", "stroke", "x")),
}
"""Key -> causality, unit, and words that a name equals or ends with; a long word may also be inside the name.
"""
_NUMBER = re.compile(r"[_.\[(]?([0-9]{1,9})[\])]?")
"""Number of a leg; Python refuses to convert a number of thousands of digits."""


@dataclass(frozen=True)
class Proposal:
    """A proposed map from the keys of section `plant.model` to variables of an FMU."""

    tool: str
    """Name of the authoring tool."""
    fmi: str
    needs_tool: bool
    mapped: Mapping[str, tuple[str, ...]]
    """force, length, rate, brake -> names in leg order; keys without a match are absent."""
    unstated: Mapping[str, str]
    """Mapped keys whose variables declare no unit -> the required unit."""
    parameters: tuple[str, ...]
    """Names of the parameters that can be set before the start."""
    obstacle: str = ""
    """Reason why it cannot be hosted on this machine as it is; empty if it has a binary for it."""
    variables: Sequence[str] = field(default=())
    """Inputs and outputs, one line each: causality, name, type, unit."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Required keys of `plant.model` without a proposal: the user has to map them."""
        return tuple(key for key in ("force", "length", "rate") if key not in self.mapped)


def propose(path: Path) -> Proposal:
    """Read an FMU's description and propose a map. Raises PlantError if the FMU cannot be read or hosted."""
    description, members = described(path)
    groups = _groups_of_six([v for v in description.modelVariables if v.type in FLOATS | SWITCHES])
    mapped: dict[str, tuple[str, ...]] = {}
    unstated: dict[str, str] = {}
    for key, role in _ROLES.items():
        taken = {name for names in mapped.values() for name in names}
        types = FLOATS | SWITCHES if key == "brake" else FLOATS
        found = _best([g for g in groups if g[0].name not in taken and {v.type for v in g} <= types], *role)
        if found is not None:
            mapped[key] = tuple(v.name for v in found)
            if (unit := role[1]) and any(stated_unit(v) is None for v in found):
                unstated[key] = unit
    clocks = any(v.type == "Clock" for v in description.modelVariables)
    obstacle = "it has clocks, as a CAN FMU: host it by `hil bus`, or as drives by plant.drives.fmu" * clocks
    try:
        library(description, members, path)
    except PlantError as error:
        obstacle = str(error).removeprefix(f"{path}: ")
    return Proposal(
        tool=description.generationTool or "unknown tool",
        fmi=description.fmiVersion,
        needs_tool=bool(description.coSimulation.needsExecutionTool),
        mapped=mapped,
        unstated=unstated,
        parameters=tuple(v.name for v in description.modelVariables if v.causality == "parameter"),
        obstacle=obstacle,
        variables=tuple(
            f"{v.causality:7} {v.name}{'' if not v.shape else list(v.shape)}  {v.type}, "
            f"{stated_unit(v) or 'no unit stated'}"
            for v in description.modelVariables
            if v.causality in {"input", "output"}
        ),
    )


def _groups_of_six(variables: Sequence[Any]) -> list[list[Any]]:
    """Groups of six variables: arrays of six elements, or names that differ in a number 0..5 or 1..6."""
    arrays = [[v] for v in variables if v.shape and tuple(v.shape) == (6,)]
    numbered: dict[tuple[str, str, str], dict[int, Any]] = {}
    for v in variables:
        for number in () if v.shape else _NUMBER.finditer(v.name):  # leg_3_force, force[3], leg[3].force
            around = v.name[: number.start()], v.name[number.end() :], v.causality
            numbered.setdefault(around, {})[int(number[1])] = v
    runs = ((numbers, range(6)) if 0 in numbers else (numbers, range(1, 7)) for numbers in numbered.values())
    return arrays + [[n[i] for i in run] for n, run in runs if set(run) == set(n)]


def _best(
    groups: list[list[Any]], causality: str, unit: str | None, words: Sequence[str]
) -> list[Any] | None:
    """The only group that fits by declared unit and name, or by name if no unit is declared; else None."""
    ranked: dict[int, list[list[Any]]] = {}
    for group in groups:
        first = group[0]
        if first.causality != causality:
            continue
        name = _NUMBER.sub(" ", first.name).strip(" _.").lower()
        parts = [part for part in re.split(r"[._\s]+", name) if part]
        exact = name in words or (bool(parts) and parts[-1] in words)
        loose = any(len(word) > 2 and word in name for word in words)
        stated = stated_unit(first)
        if stated is not None and stated != unit:
            continue
        if exact or loose:
            ranked.setdefault(2 * (stated is not None) + exact, []).append(group)
    best = ranked[max(ranked)] if ranked else []
    return best[0] if len(best) == 1 else None
