"""A YAML file that holds one section: what commands hand to each other.

Rule of the room: reads the file it is given, starts nothing. Every problem is reported at once, each as
`file:line:column: path: what, allowed, given`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from drivers.config import Section
from drivers.errors import ConfigurationError
from hil.app import problems as translate
from hil.app.yaml_positions import Document, Problem, parse

Kind = TypeVar("Kind", bound=Section)


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises FileNotFoundError where there is none, ConfigurationError where it cannot be read as UTF-8.
    """
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
        raise ConfigurationError(f"{path}:{line}:{column}: not UTF-8 text") from None


def read_section(path: Path, kind: type[Kind]) -> tuple[Kind, Document]:
    """Return the section that is the whole of a file, and where its keys and values stand.

    Raises ConfigurationError with all problems found.
    """
    try:
        document = parse(read_text(path))
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such file") from None
    found = list(document.problems)
    if document.value is not None:
        try:
            section = kind.model_validate_json(json.dumps(document.value), strict=True)
        except ValidationError as error:
            found += translate.problems(error, document, kind.model_json_schema())
    if found:
        raise ConfigurationError(*(p.line(str(path)) for p in sorted(set(found), key=_order)))
    return section, document


def _order(problem: Problem) -> tuple[tuple[int, int], str]:
    return problem.position, problem.message
