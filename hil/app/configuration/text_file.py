"""Where the text of a configuration stands: in a file, or in a shipped one, by its name.

Cheap to import: `hil ctl CONFIG estop` reads no more than this and section `bus`.
"""

import importlib.resources
from pathlib import Path

from drivers.errors import ConfigurationError
from drivers.files import read_regular


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises FileNotFoundError where there is none, ConfigurationError where it is no regular file, too large,
    or cannot be read as UTF-8.
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
    """Return the names of the configurations that come with the product, or of its controllers or designs."""
    files = importlib.resources.files("configs").joinpath(kind).iterdir()
    return tuple(sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml")))


def shipped_file(name: str, kind: str = "") -> Path:
    """Return the file of a shipped configuration, controller or design."""
    return Path(str(importlib.resources.files("configs").joinpath(kind, f"{name}.yaml")))


def read_configuration(path: str | Path) -> tuple[Path, str]:
    """Return the file of a configuration, or of a shipped one by its name (`virtual`), and its text.

    A file of that name comes first, a folder does not: `python -m venv virtual` hides nothing.
    Raises ConfigurationError where there is none, or it cannot be read.
    """
    file = Path(path)
    if (not file.exists() or file.is_dir()) and str(path) in shipped():
        file = shipped_file(str(path))
    try:
        return file, read_text(file)
    except FileNotFoundError:
        names = ", ".join(shipped())
        raise ConfigurationError(f"{path}: no such file; shipped configurations are: {names}") from None
