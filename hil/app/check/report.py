"""Report of `hil check`, and the format of figures in its lines."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from string import Formatter
from textwrap import dedent
from typing import Any

from hil.app.check.subject import Subject

DETAILS = ("encoders", "operating", "motor to leg", "real time")
"""Beginnings of the titles of sections that only `hil check -v` prints."""
SCALES = {"milli": 1e3, "micro": 1e6, "percent": 1e2}


class NothingError(Exception):
    """A line of the report needs a figure that is missing."""


class Scaled(Formatter):
    """`str.format` with the formats `{x_m:milli.3f} mm`, `{t_s:micro.0f} us` and `{share:percent.3g} %`."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """Format a value in the unit of `format_spec`. Raises NothingError for None."""
        if value is None:
            raise NothingError
        unit, rest = re.fullmatch("(milli|micro|percent)?(.*)", format_spec).groups()  # type: ignore[union-attr]
        return format(value if unit is None else SCALES[unit] * value, rest)


@dataclass
class Report:
    """Report of `hil check`: figures of a configuration, in sections, and warnings."""

    s: Subject
    sections: dict[str, list[str]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    codes: list[str] = field(default_factory=list)
    """Codes of the warnings, one each."""
    figures: dict[str, Any] = field(default_factory=dict)
    """The figures as plain values, for `--json`."""

    def add(self, title: str, lines: str, figures: Mapping[str, Any] | None = None, **values: Any) -> None:
        """Add lines to a section, formatted with the subject `s`, its configuration `c`, figures and values.

        A line with a figure that is None is left out.
        """
        given = {"s": self.s, "c": self.s.c, **(figures or {}), **values}
        section = self.sections.setdefault(title, [])
        for line in dedent(lines).strip("\n").splitlines():
            with suppress(NothingError):
                section.append(Scaled().vformat(line, (), given))

    @property
    def lines(self) -> list[str]:
        """The whole report as text lines."""
        return self.text(whole=True)

    def text(self, *, whole: bool) -> list[str]:
        """Report as text lines: number of warnings, warnings, figures; whole: with the sections DETAILS."""
        count = len(self.warnings)
        text = [f"{self.s.c.name}: valid, {count or 'no'} warning{'s' * (count != 1)}"]
        text += [f"  warning: {w}" for w in self.warnings]
        hidden = [] if whole else [title for title in self.sections if title.startswith(DETAILS)]
        for title, lines in self.sections.items():
            if title not in hidden:
                text += [title, *(f"  {line}" for line in lines)]
        return text + ([f"further figures, with -v: {'; '.join(hidden)}"] if hidden else [])

    def to_dict(self) -> dict[str, Any]:
        """The report as plain values, for `--json`."""
        return {"configuration": self.s.c.name, "figures": self.figures, "warnings": self.warnings}
