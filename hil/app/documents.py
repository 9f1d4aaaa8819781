"""Files that one command writes and another reads: a model of their content, as YAML.

Rule of the room: knows how to read, refuse and write; not what the keys mean.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import ValidationError

from drivers.config import Section
from drivers.errors import ConfigurationError
from hil.app import problems as translate
from hil.app.yaml_positions import parse

Content = TypeVar("Content", bound=Section)


def read_document(path: Path, model: type[Content]) -> Content:
    """Read a file whose content `model` describes; its key `kind` says what it is.

    Raises ConfigurationError: not there, not readable, another kind of file, or all that is wrong in it.
    """
    try:
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: not UTF-8 text") from None
    document = parse(text)
    expected = kind_of(model)
    if document.value is not None and document.value.get("kind") != expected:
        raise ConfigurationError(
            f"{path}: holds kind {document.value.get('kind')!r}, allowed: {expected}; it is another file"
        )
    found = list(document.problems)
    if document.value is not None and not found:
        try:
            return model.model_validate_json(json.dumps(document.value), strict=True)
        except ValidationError as error:
            found += translate.problems(error, document, model.model_json_schema())
    raise ConfigurationError(*(problem.line(str(path)) for problem in sorted(set(found))))


def write_document(path: Path, content: Section, remark: str) -> None:
    """Write content as YAML under a line of remark, whole or not at all.

    Raises ConfigurationError if it cannot be written.
    """
    text = f"# {remark}\n" + yaml.safe_dump(
        content.model_dump(mode="json"),
        sort_keys=False,
        allow_unicode=True,
        width=110,
        default_flow_style=None,
    )
    try:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".yaml", delete=False) as file:
            file.write(text)
        umask = os.umask(0)
        os.umask(umask)
        Path(file.name).chmod(0o666 & ~umask)
        Path(file.name).replace(path)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from None


def check_document_path(option: str, path: Path, model: type[Section]) -> None:
    """Refuse a file that could not be written in the end, before anything starts; an earlier one is replaced.

    Raises ConfigurationError: no such folder, no right to write, or a file of another kind.
    """
    where = f"{option} {path}"
    if not path.parent.is_dir():
        raise ConfigurationError(f"{where}: there is no folder {path.parent}; make it first")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigurationError(f"{where}: no right to write there")
    if path.exists() and not _is_kind(path, kind_of(model)):
        raise ConfigurationError(
            f"{where}: exists, is no {kind_of(model)} and is not overwritten; name another file"
        )


def kind_of(model: type[Section]) -> str:
    """Return what the key `kind` says in files of this model."""
    kind: str = model.model_json_schema()["properties"]["kind"]["const"]
    return kind


def _is_kind(path: Path, kind: str) -> bool:
    try:
        document = parse(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        return False
    return document.value is not None and document.value.get("kind") == kind
