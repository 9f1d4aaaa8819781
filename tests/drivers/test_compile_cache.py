import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.compile_cache import CHECKED
from hil.log import Log
from hil.row import _fill

ROOT = Path(__file__).resolve().parents[2]


def simulate(log: Path, **environment: str) -> np.ndarray:
    """Return the rows of a short run in a process of its own."""
    command = [sys.executable, "-m", "hil.cli", "sim", "virtual", "--duration", "0.2", "--log", str(log)]
    rest = {name: value for name, value in os.environ.items() if name != "HIL_CHECK_KERNELS"}
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT, env=rest | environment)
    return Log.open(log).rows()


def test_kernels_that_trust_their_callers_compute_what_those_that_look_do(tmp_path):
    trusting = simulate(tmp_path / "trusting.mcap")
    looking = simulate(tmp_path / "looking.mcap", HIL_CHECK_KERNELS="1")
    assert trusting.tobytes() == looking.tobytes()


def test_the_suite_runs_with_kernels_that_refuse_other_types():
    assert CHECKED
    fill: Any = _fill
    with pytest.raises(TypeError, match="No matching definition"):
        fill(np.zeros(6, np.float32), *[0.0] * 36)
