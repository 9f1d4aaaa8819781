"""Where results go: log names, the summary on the terminal, its JSON twin, the picture.

Rule of the room: formats and writes; computes nothing about the platform.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from drivers.errors import LogError

console = Console(stderr=True, highlight=False)


def log_path(folder: str, name: str, given: Path | None, suffix: str = "") -> Path:
    """Return the log file to write: the given one, or a new dated one in the recordings folder.

    Raises LogError if the file exists: no log is ever overwritten.
    """
    path = given
    if path is None:
        stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
        path = Path(folder) / f"{name}-{stamp}{suffix}.mcap"
        number = 2
        while path.exists():
            path = Path(folder) / f"{name}-{stamp}-{number}{suffix}.mcap"
            number += 1
    if path.exists():
        raise LogError(f"{path}: exists and is not overwritten; name another file with --log")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"{path.parent}: cannot be made: {error.strerror}") from None
    return path


def write_json(path: Path, summary: dict[str, Any]) -> None:
    """Write a summary, whole or not at all.

    Raises LogError if the folder cannot be written.
    """
    try:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".json", delete=False) as file:
            json.dump(summary, file, indent=2)
            file.write("\n")
        Path(file.name).chmod(0o666 & ~_umask())
        Path(file.name).replace(path)
    except OSError as error:
        raise LogError(f"--json {path}: cannot be written: {error.strerror}") from None


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def show(title: str, summary: dict[str, Any]) -> None:
    """Print a summary as a table, nested keys dotted."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0))
    for key, value in _flat(summary):
        table.add_row(key, value)
    Console(highlight=False).print(table)


def _flat(summary: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in summary.items():
        name = f"{prefix}{key}".replace("_", " ")
        if isinstance(value, dict) and all(isinstance(v, int | float) for v in value.values()):
            rows.append((name, ", ".join(f"{k.replace('_', ' ')} {_number(v)}" for k, v in value.items())))
        elif isinstance(value, dict):
            rows += _flat(value, f"{prefix}{key} ")
        elif isinstance(value, list):
            rows.append((name, "; ".join(str(v) for v in value) or "none"))
        else:
            rows.append((name, _number(value)))
    return rows


def _number(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return str(value)
