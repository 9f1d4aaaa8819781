"""A configuration as YAML with a comment beside each number that says where it comes from."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

_PLAIN = re.compile(r"[^\W\d_][\w./ -]*[\w./-]|[^\W\d_]")
_NOT_TEXT = frozenset(("true", "false", "null", "yes", "no", "on", "off", "y", "n"))
"""What YAML 1.1 or 1.2 reads as something else."""
COLUMN = 40
"""Where comments begin."""
DIGITS = 7
"""Of a float. Answers have no more: what follows from one is to fit the one that is written."""


def yaml_text(head: list[str], sections: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    """Return head as comment lines, then the sections; comments are keyed by dotted path."""
    lines = [f"# {line}".rstrip() for line in head]
    for key, value in sections.items():
        if isinstance(value, Mapping) or key == "name":
            lines.append("")
        lines += _entry((key,), value, comments)
    return "\n".join(lines) + "\n"


def _entry(path: tuple[str, ...], value: Any, comments: Mapping[str, str]) -> Iterator[str]:
    indent = "  " * (len(path) - 1)
    comment = comments.get(".".join(path))
    if isinstance(value, Mapping) and value:
        yield _commented(f"{indent}{path[-1]}:", comment)
        for key, inner in value.items():
            yield from _entry((*path, key), inner, comments)
    elif isinstance(value, list) and value and isinstance(value[0], Mapping):
        yield _commented(f"{indent}{path[-1]}:", comment)
        for item in value:
            yield f"{indent}  - {flow(item)}"
    else:
        yield _commented(f"{indent}{path[-1]}: {flow(value)}", comment)


def _commented(line: str, comment: str | None) -> str:
    return line if comment is None else f"{line:<{COLUMN}} # {comment}"


def flow(value: Any) -> str:
    """Return a value on one line; floats to `DIGITS` as numbers of YAML 1.2, a Decimal as it is."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(flow(v) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    text = str(value)
    plain = not isinstance(value, str) or (_PLAIN.fullmatch(text) and text.lower() not in _NOT_TEXT)
    return text if plain else json.dumps(text, ensure_ascii=False)
