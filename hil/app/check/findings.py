"""What `hil check` has found."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Report:
    """Figures of a configuration, in sections, and what is worth a warning."""

    name: str
    sections: dict[str, list[str]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    """The same as plain values, for `--json`."""

    @property
    def lines(self) -> list[str]:
        """All as text."""
        text = [f"configuration {self.name}"]
        for title, lines in self.sections.items():
            text += [title, *(f"  {line}" for line in lines)]
        return text + [f"warning: {w}" for w in self.warnings]

    def to_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {"configuration": self.name, "figures": self.figures, "warnings": self.warnings}
