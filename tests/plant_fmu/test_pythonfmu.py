"""The guide's recipe with PythonFMU itself; skipped if PythonFMU is not installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.app.check.command import inspect
from hil.app.configuration.configuration import load
from hil.app.sim.command import simulate
from hil.cli import main

pytest.importorskip("pythonfmu")
ROOT = Path(__file__).resolve().parents[2]
ROBOT = (
    "--base-radius 0.2 --platform-radius 0.12 --length-min 0.25 --stroke 0.1 --mass 5 --leg-mass 0 --drive-force 200 "
    "--drive-speed 0.2 --com-height 0.02"
)


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    plant = str(ROOT / "docs/examples/pythonfmu_plant.py")
    subprocess.run(
        [sys.executable, "-m", "pythonfmu", "build", "-f", plant, "-d", str(folder)], check=True, timeout=120
    )
    path = folder / "my.yaml"
    done = CliRunner().invoke(
        main, ["new", str(path), "--yes", "--fmu", str(folder / "PythonPlant.fmu"), *ROBOT.split()]
    )
    assert done.exit_code == 0, done.output
    return path


def test_mobility_of_a_pythonfmu_plant_is_that_of_the_controllers_model(own):
    """Two programs of one robot: the controller's mass matrix, and the FMU's response to 1 N in each leg."""
    import numpy as np  # noqa: PLC0415

    from hil.app.configuration.platform import platform_dict, pose_arrays  # noqa: PLC0415
    from hil.dynamics import Model  # noqa: PLC0415
    from hil.geometry import Platform  # noqa: PLC0415
    from hil.kinematics import jacobian  # noqa: PLC0415

    c = load(own)
    report = inspect(c)
    assert report.figures["fmu"]["uncoupled"] is False
    assert set(report.figures["fmu"]["assumed_units"].values()) == {"N", "m", "m/s"}
    platform = Platform.from_dict(platform_dict(c.platform))
    p, R = pose_arrays(c.platform.home)
    J, M = jacobian(platform, p, R), Model(platform).mass_matrix(p, R)
    expected = J @ np.linalg.solve(M, J.T)
    np.testing.assert_allclose(report.figures["fmu"]["mobility_1_kg"], expected, atol=2e-3 * expected.max())


@pytest.mark.long
def test_run_with_a_pythonfmu_plant_tracks_parks_and_replays(own, tmp_path):
    summary = simulate(load(own), log=tmp_path / "run.mcap", duration_s=3.0)
    assert summary["success"]
    assert summary["replay"]["agrees"]
    assert summary["tracking"]["peak_leg_error_mm"] < 0.05
