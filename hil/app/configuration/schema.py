"""The JSON Schema of a configuration, for editors."""

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
"""Beside the shipped configurations, which name it in their first line."""
MODELINE = "# yaml-language-server: $schema="
HEAD_LINES = 10
"""Lines in which it is looked for."""


def schema() -> dict[str, Any]:
    """Return the schema, JSON Schema draft 2020-12, with the docstrings of the keys as descriptions."""
    return described("Configuration", json_schema(), "hexapod-hil configuration")


def described(name: str, plain: dict[str, Any], title: str) -> dict[str, Any]:
    """Return the schema of the section class `name` as pydantic has it, with the docstrings of the keys."""
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
    """Return the schema as the committed file has it."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def schema_path() -> Path:
    """Return the schema file of this installation, in a clone or a wheel."""
    return Path(str(importlib.resources.files("configs") / FILE))


def schema_line() -> str:
    """Return the first line by which an editor finds the schema, wherever the configuration stands."""
    return f"{MODELINE}{schema_path()}"


def named_schema(text: str) -> str | None:
    """Return what the first lines of a configuration name as their schema; None where they name none."""
    lines = text.removeprefix("\ufeff").splitlines()[:HEAD_LINES]
    return next((line.removeprefix(MODELINE).strip() for line in lines if line.startswith(MODELINE)), None)


def schema_is_there(text: str, folder: Path) -> bool:
    """Tell whether the schema that a text in `folder` names can be loaded; true where it names none."""
    named = named_schema(text)
    return named is None or "://" in named or (folder / named).is_file()


def with_schema(text: str) -> str:
    """Return the text of a configuration with the line that names this installation's schema.

    A byte order mark goes: YAML allows it in front of the whole text only.
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
    """Return the string below each field, also of the bases.

    pydantic can do it as each class is made (`use_attribute_docstrings`): a fifth of the start of every
    command, for what only editors read.
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
