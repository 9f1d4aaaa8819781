"""JSON Schema of a configuration file, with which editors complete and check keys."""

import ast
import importlib.resources
import inspect
import json
from collections.abc import Iterator
from copy import deepcopy
from itertools import pairwise
from pathlib import Path
from typing import Any

from drivers.section import Section
from hil.app.configuration.configuration import json_schema

FILE = "hil.schema.json"
"""File next to the shipped configurations, which refer to it in their first line."""
MODELINE = "# yaml-language-server: $schema="
HEAD_LINES = 10
"""Number of first lines in which a text may refer to its schema."""


def schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a configuration, with the docstrings of the keys as descriptions."""
    return described("Configuration", json_schema(), "hexapod-hil configuration")


def described(name: str, plain: dict[str, Any], title: str) -> dict[str, Any]:
    """Pydantic's JSON Schema `plain` of the section class `name`, with the docstrings of the keys added."""
    whole = deepcopy(plain)
    models = {model.__name__: model for model in _sections(Section)}
    for section_name, section in ((name, whole), *whole["$defs"].items()):
        for key, words in _docstrings(models[section_name]).items():
            section["properties"][key]["description"] = words
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        **{key: value for key, value in whole.items() if key != "title"},
    }


def text() -> str:
    """JSON Schema of a configuration as text, as in the committed file."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def schema_path() -> Path:
    """JSON Schema file of this installation, in a clone or a wheel."""
    return Path(str(importlib.resources.files("configs") / FILE))


def schema_line() -> str:
    """First line of a configuration with which an editor finds the schema, wherever the file lies."""
    return f"{MODELINE}{schema_path()}"


def named_schema(text: str) -> str | None:
    """Schema that the first lines of a configuration refer to; None without such a line."""
    lines = text.removeprefix("\ufeff").splitlines()[:HEAD_LINES]
    return next((line.removeprefix(MODELINE).strip() for line in lines if line.startswith(MODELINE)), None)


def schema_is_there(text: str, folder: Path) -> bool:
    """True if the schema of a configuration text in `folder` exists, or if the text has none."""
    named = named_schema(text)
    return named is None or "://" in named or (folder / named).is_file()


def with_schema(text: str) -> str:
    """Text of a configuration with a line that refers to this installation's JSON Schema.

    A byte order mark is removed: YAML allows it only at the start of a text.
    """
    lines = text.removeprefix("\ufeff").splitlines(keepends=True)
    there = next((k for k, line in enumerate(lines[:HEAD_LINES]) if line.startswith(MODELINE)), None)
    lines[slice(0, 0) if there is None else slice(there, there + 1)] = [f"{schema_line()}\n"]
    return "".join(lines)


def _sections(section: type[Section]) -> Iterator[type[Section]]:
    for derived in section.__subclasses__():
        yield derived
        yield from _sections(derived)


def _docstrings(section: type[Section]) -> dict[str, str]:
    """{field: docstring below it} of a section class, base classes included.

    pydantic can do this for each class (`use_attribute_docstrings`), but that adds a fifth to the start of
    every command, and only editors read the result.
    """
    found: dict[str, str] = {}
    for base in reversed(section.__mro__[: section.__mro__.index(Section)]):
        (definition,) = ast.parse(inspect.getsource(base)).body
        assert isinstance(definition, ast.ClassDef)
        for field, below in pairwise(definition.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                    found[name] = inspect.cleandoc(words)
    return {name: words for name, words in found.items() if name in section.model_fields}
