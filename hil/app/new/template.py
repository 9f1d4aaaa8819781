"""Fills the template of a new configuration with values: numbers in YAML syntax, each with a comment."""

from __future__ import annotations

import importlib.resources
import json
import re
from collections.abc import Mapping
from typing import Any

from hil.app.configuration.yaml_positions import parse

SECTIONS = (
    importlib.resources.files("hil.app.new").joinpath("robot.yaml.template").read_text("utf-8").split("\n\n")
)
DIGITS = 7
"""Digits of a float. Answers have no more, so that derived values fit the written answer."""
COLUMN = 40
"""Column of comments."""
_NAME = re.compile(r"\$(\w+)")
_PLAIN = re.compile(r"[^\W\d_][\w./ -]*[\w./-]|[^\W\d_]")
_NOT_TEXT = frozenset(("true", "false", "null", "yes", "no", "on", "off", "y", "n"))
"""Text that YAML 1.1 or 1.2 does not read as text."""


def filled(section: str, values: Mapping[str, Any]) -> str:
    """Section of the template with values for `$name`; a line `?name|...` is kept if the value is set."""
    lines = []
    for line in section.splitlines():
        condition, _, rest = line[1:].partition("|") if line.startswith("?") else ("", "", line)
        if not condition or values.get(condition):
            text, mark, comment = rest.partition("  # ")
            text = _NAME.sub(lambda name: flow(values[name[1]]), text)
            lines.append(f"{text:<{COLUMN}} # {comment}" if mark else text)
    return "\n".join(lines)


def settings(name: str, values: Mapping[str, Any]) -> Any:
    """Section `name` of the template as plain data, as a file with these values would be parsed."""
    (section,) = (each for each in SECTIONS if each.startswith(f"{name}:"))
    read: Any = parse(filled(section, values)).value
    return read[name]


def flow(value: Any) -> str:
    """Value as YAML on one line; floats with `DIGITS` digits in YAML 1.2 syntax."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(v) for v in value) + "]"
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    text = str(value)
    plain = not isinstance(value, str) or (_PLAIN.fullmatch(text) and text.lower() not in _NOT_TEXT)
    return text if plain else json.dumps(text, ensure_ascii=False)
