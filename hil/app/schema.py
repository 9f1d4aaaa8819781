"""The JSON Schema of a configuration, for editors.

Rule of the room: generated from the models; the committed file is checked by a test.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hil.app.configuration import SCHEMA

FILE = "hil.schema.json"
"""Beside the shipped configurations, which name it in their first line."""


def schema() -> dict[str, Any]:
    """Return the schema, JSON Schema draft 2020-12."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "hexapod-hil configuration",
        **{key: value for key, value in SCHEMA.items() if key != "title"},
    }


def text() -> str:
    """Return the schema as the committed file has it."""
    return json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"


def write(folder: Path) -> Path:
    """Write the schema into `folder` for configurations that stand there; return the file."""
    path = folder / FILE
    path.write_text(text(), encoding="utf-8")
    return path
