"""What to host and how our legs map to its variables: the plain data that also goes to a child process."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from plant_fmu.config import FmuPlant

Parameter = float | int | bool | str | list[float]


@dataclass(frozen=True)
class TruthNames:
    """Output arrays that hold the true pose and forces."""

    position: str
    rotation: str
    twist: str
    applied_force: str


@dataclass(frozen=True)
class FmuSpec:
    """An FMU, six legs' variables, parameters and the step that all communication steps are multiples of."""

    path: Path
    force: tuple[str, ...]
    length: tuple[str, ...]
    rate: tuple[str, ...]
    step_s: float
    brake: tuple[str, ...] = ()
    wrench: tuple[str, ...] = ()
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    truth: TruthNames | None = None

    def to_json(self) -> str:
        """Return the text that `from_json` reads back; floats survive to the bit."""
        return json.dumps({**asdict(self), "path": str(self.path)})

    @staticmethod
    def from_json(text: str) -> FmuSpec:
        """Inverse of `to_json`."""
        d = json.loads(text)
        lists = {k: tuple(d[k]) for k in ("force", "length", "rate", "brake", "wrench")}
        truth = TruthNames(**d["truth"]) if d["truth"] else None
        return FmuSpec(**{**d, **lists, "path": Path(d["path"]), "truth": truth})


def spec_from_settings(settings: FmuPlant, folder: Path) -> FmuSpec:
    """Return the spec of a configured FMU; a relative path starts at `folder`, the configuration's."""
    return FmuSpec(
        path=folder / settings.path,
        force=tuple(settings.force),
        length=tuple(settings.length),
        rate=tuple(settings.rate),
        brake=tuple(settings.brake),
        wrench=tuple(settings.wrench),
        parameters=dict(settings.parameters),
        step_s=settings.step_us / 1e6,
    )
