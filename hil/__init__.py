"""The controller: geometry, dynamics, control laws, safety, the cycle, recording and replay.

The names below are stable: `Log` reads a recorded run, `sim` makes one, `OperatorClient` operates one. Each
name is imported at its first use, so that `import hil` and reading a log need no compilation.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from drivers.errors import (
        BusError,
        ConfigurationError,
        HilError,
        LogError,
        ModelError,
        PlantError,
        ProtocolError,
        RunError,
    )
    from drivers.protocol import Frame, Received
    from drivers.tick_columns import Column
    from hil.app.simulation import Run, sim
    from hil.operate.client import Answer, OperatorClient, Streamed
    from hil.record.log import Event, Log, LoggedFrame, LogStatistics, Tick
    from hil.signals import SetPoint

__all__ = [
    "Answer",
    "BusError",
    "Column",
    "ConfigurationError",
    "Event",
    "Frame",
    "HilError",
    "Log",
    "LogError",
    "LogStatistics",
    "LoggedFrame",
    "ModelError",
    "OperatorClient",
    "PlantError",
    "ProtocolError",
    "Received",
    "Run",
    "RunError",
    "SetPoint",
    "Streamed",
    "Tick",
    "sim",
]

_HOMES = {
    "drivers.errors": [name for name in __all__ if name.endswith("Error")],
    "drivers.protocol": ["Frame", "Received"],
    "drivers.tick_columns": ["Column"],
    "hil.app.simulation": ["Run", "sim"],
    "hil.operate.client": ["Answer", "OperatorClient", "Streamed"],
    "hil.record.log": ["Event", "Log", "LogStatistics", "LoggedFrame", "Tick"],
    "hil.signals": ["SetPoint"],
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def foreign_package() -> str:
    """Sentence about a package that hides `drivers`, `plant_fmu` or `configs` of this project; else empty."""
    for name in ("drivers", "plant_fmu", "configs"):
        spec = find_spec(name)
        found = Path(spec.origin).resolve().parent if spec and spec.origin else None
        if found != Path(__file__).resolve().parents[1] / name:
            return (
                f"{found} hides the package {name!r} of hexapod-hil: take {found and found.parent} off "
                "PYTHONPATH, or install hexapod-hil into an environment of its own"
            )
    return ""


def __getattr__(name: str) -> Any:
    """Import a public name at its first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if found := foreign_package():
        raise ImportError(found)
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
