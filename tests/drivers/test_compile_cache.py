import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.compile_cache import CHECKED
from hil.cli import main
from hil.log import Log
from hil.row import _fill
from hil.signals import Mode

ROOT = Path(__file__).resolve().parents[2]


def test_kernels_that_trust_their_callers_compute_what_those_that_look_do(tmp_path):
    """Those of this process look; trusting ones need a process of their own."""
    looking, trusting = tmp_path / "looking.mcap", tmp_path / "trusting.mcap"
    words = ["sim", "virtual", "--duration", "1.2", "--log"]  # into TRACKING
    assert CHECKED
    result = CliRunner().invoke(main, [*words, str(looking)])
    assert result.exit_code == 0, result.output
    rest = {name: value for name, value in os.environ.items() if name != "HIL_CHECK_KERNELS"}
    command = [sys.executable, "-m", "hil.cli", *words, str(trusting)]
    subprocess.run(command, check=True, capture_output=True, cwd=ROOT, env=rest)
    rows = Log.open(looking).rows()
    assert Log.open(trusting).rows().tobytes() == rows.tobytes()
    assert np.count_nonzero(rows["mode"] == Mode.TRACKING) > 100, "the kernels of the path and of the law"


def test_the_suite_runs_with_kernels_that_refuse_other_types():
    assert CHECKED
    fill: Any = _fill
    with pytest.raises(TypeError, match="No matching definition"):
        fill(np.zeros(6, np.float32), *[0.0] * 36)
