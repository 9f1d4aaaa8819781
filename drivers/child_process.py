"""Start of a module of this project in a child process."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_HERE = str(Path(__file__).resolve().parents[1])


def start(
    module: str, *arguments: str, environment: Mapping[str, str] | None = None, **options: Any
) -> subprocess.Popen[bytes]:
    """Start `python -m module`, which imports our packages but nothing from the working directory.

    environment: variables to add; options: as for `subprocess.Popen`. Raises OSError.
    """
    path = os.pathsep.join(filter(None, (_HERE, os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", module, *arguments],
        env={**os.environ, "PYTHONPATH": path, **(environment or {})},
        **options,
    )
