"""Reads the text of a configuration: of a file, or of a shipped configuration by its name.

Cheap to import: `hil ctl CONFIG estop` reads only this and section `bus`.
"""

import importlib.resources
from pathlib import Path

from drivers.errors import ConfigurationError
from drivers.files import read_regular


def read_text(path: Path) -> str:
    """Text of a UTF-8 file.

    Raises FileNotFoundError if it is missing, ConfigurationError if it is not a regular file, is too large,
    or is not UTF-8.
    """
    try:
        raw = read_regular(path)
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


def shipped(kind: str = "") -> tuple[str, ...]:
    """Names of the shipped configurations, or of the shipped controllers or designs (`kind`: folder)."""
    files = importlib.resources.files("configs").joinpath(kind).iterdir()
    return tuple(sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml")))


def shipped_file(name: str, kind: str = "") -> Path:
    """Path of a shipped configuration, controller or design; `kind`: its folder."""
    return Path(str(importlib.resources.files("configs").joinpath(kind, f"{name}.yaml")))


def read_configuration(path: str | Path) -> tuple[Path, str]:
    """(file, text) of a configuration: a path, or the name of a shipped one, e.g. `virtual`.

    A file of that name has priority, a folder has not: `python -m venv virtual` hides nothing. Raises
    ConfigurationError if the file is missing or cannot be read.
    """
    file = Path(path)
    if (not file.exists() or file.is_dir()) and str(path) in shipped():
        file = shipped_file(str(path))
    try:
        return file, read_text(file)
    except FileNotFoundError:
        names = ", ".join(shipped())
        raise ConfigurationError(f"{path}: no such file; shipped configurations are: {names}") from None
