"""YAML file with one section, which one command writes and another command reads.

All problems are reported at once, each as `file:line:column: path: what, allowed, given`.
"""

from pathlib import Path
from typing import Any, TypeVar

import yaml

from drivers.errors import ConfigurationError
from drivers.section import Section
from hil.app.configuration.problems import checked
from hil.app.configuration.text_file import read_text
from hil.app.configuration.yaml_positions import Document, parse
from hil.app.files import Kind, new_file, printable, write_whole

Of = TypeVar("Of", bound=Section)


def read_section(path: Path, kind: type[Of]) -> tuple[Of, Document]:
    """(section, document with the positions of keys and values) of a YAML file.

    Raises ConfigurationError with all problems found.
    """
    try:
        document = parse(read_text(path))
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: no such file") from None
    value: dict[str, Any] = document.value or {}
    given, strange = value.get("kind"), [key for key in value if key not in kind.model_fields]
    if given != _name(kind) and (given is not None or 2 * len(strange) > len(value)):
        # for a file of another kind, single problems are not helpful
        what = f"of kind {given!r:.60}, with the keys {', '.join(list(value)[:3])} ..."
        raise ConfigurationError(f"{path}: is {what}; allowed: a file with `kind: {_name(kind)}`")
    return checked(kind, document, str(path)), document


def write_section(path: Path, section: Section, remark: str) -> None:
    """Write a section as YAML below a comment line, completely or not at all.

    Raises ConfigurationError if it cannot be written.
    """
    data = section.model_dump(mode="json")
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)
    try:
        write_whole(path, f"# {printable(remark)}\n{text}")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from None


def check_section_path(option: str, path: Path, kind: type[Section]) -> None:
    """Check before any work that a section file can be written; an earlier file is replaced.

    option: command-line option that sets the path. Raises LogError, as `new_file`.
    """
    name = _name(kind)
    new_file(path, option=option, own=Kind(f"a file of kind {name}", lambda file: _says(file, name)))


def _name(kind: type[Section]) -> str:
    """Value of the key `kind` in files of this kind."""
    name: str = kind.model_json_schema()["properties"]["kind"]["const"]
    return name


def _says(path: Path, name: str) -> bool:
    try:
        document = parse(read_text(path))
    except (OSError, ConfigurationError):
        return False
    return document.value is not None and document.value.get("kind") == name
