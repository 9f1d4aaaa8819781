"""The controller in the protocol's guide, with python-can and cantools only, moves the drives of `hil plant`."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.realtime.rig import CHANNEL, ROOT, START_S, Process

pytestmark = pytest.mark.realtime(patient=True)
EXAMPLE = ROOT / "docs" / "examples" / "foreign_controller.py"


@pytest.mark.long
def test_example_controller_sets_up_lifts_and_parks_the_drives(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    text = (ROOT / "configs" / "bench.yaml").read_text()
    for old, new in (
        ("channel: bench0", f"channel: {CHANNEL}"),
        ("folder: runs", f"folder: {tmp_path}/runs"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    file = tmp_path / "bench.yaml"
    file.write_text(text)
    plant = start("plant", str(file))
    plant.wait_for_child("hil.record")
    run = subprocess.run(
        [sys.executable, str(EXAMPLE), str(ROOT / "drivers/legs/legs.dbc"), CHANNEL],
        capture_output=True, text=True, timeout=START_S, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    moved = [float(number) for number in re.findall(r"-?[0-9.]+", run.stdout)]
    assert len(moved) == 6
    assert min(moved) > 5.0, "less than commanded, against the springs"
    plant.interrupt()
    assert plant.wait() == 0, plant.errors
    summary = plant.summary
    assert summary["final_states"] == ["OFF"] * 6
    assert summary["rejected_frames"] == 0
    assert summary["commands"] > 300
