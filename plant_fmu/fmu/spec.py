"""What to host and how our legs map to its variables: the plain data that also goes to a child process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Parameter = float | int | bool | str | list[float]


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
    truth: tuple[str, ...] = ()
    """Outputs that hold position, rotation, twist and applied forces; empty where they are not known."""
    assume_unit: Mapping[str, str] = field(default_factory=dict)
    """Variable, or one of force, length, rate, wrench -> its unit where the description states none."""
    allow_execution_tool: bool = False
    """Take an FMU that needs the tool that made it."""
    memory_GB: float = 4.0
    """Most that a child process may have of its own."""
