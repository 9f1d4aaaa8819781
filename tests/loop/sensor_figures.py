"""Sensors beside bought drives, for docs/guides/sensors.md: `python -m tests.loop.sensor_figures --json FILE`.

`desktop` with a draw-wire encoder and a load cell on each leg, and a tracker, on a second bus: errors of the pose
against the plant's truth, by the legs alone and fused with the tracker.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.arrays import Rows
from drivers.signals import Mode
from hil.app.check.command import inspect
from hil.app.configuration.configuration import Configuration
from hil.app.sim.command import simulate
from hil.record.log import Log
from plant_fmu.faults.kinds import EncoderJump
from plant_fmu.faults.plan import FaultPlan
from tests.loop.bench import changed
from tests.loop.test_sensor_families import on_a_bus_of_their_own

FAMILIES = {
    "damiao": "mit, damiao DM4310", "moteus": "moteus", "odrive": "odrive", "cia402": "cia402, difference"
}  # fmt: skip
TRACKER = {"rate_Hz": 200, "position_std_m": 2e-4, "orientation_std_deg": 0.03}
NOISE = {"position_noise_m": 2e-4, "orientation_noise_deg": 0.03, "latency_ms": 5, "lost_percent": 2}
FUSED = {"pose": "fused", "fusion": {"may_lose_legs": [*range(6)]}}


def bench(family: str, *, used: bool) -> Configuration:
    """`desktop` with the sensors; used: the pose is fused with the tracker."""
    c = on_a_bus_of_their_own(FAMILIES[family])
    lengths = {"on_contradiction": "warn"}
    noise = {"tracker": NOISE, "lengths": {"noise_m": 2e-5}, "forces": {"noise_N": 1}}
    c = changed(c, sensors={"tracker": TRACKER, "lengths": lengths}, plant={"sensors": noise})
    return changed(c, estimation=FUSED) if used else c


def pose_errors(rows: Rows, truth: Rows) -> tuple[float, float]:
    """Largest errors of the pose, um and 1e-3 deg, while TRACKING, at the instants for which it counts."""
    latch = np.where(rows["latch_ns"] > 0, rows["latch_ns"], np.iinfo(np.int64).max).min(axis=1)
    t = (rows["t_ns"] + rows["lateness_ns"] + latch) * 1e-9
    at = np.searchsorted(truth["tick"], rows["tick"])
    true = truth[at]
    assert (true["tick"] == rows["tick"]).all()
    dt = (t - true["t_ns"] * 1e-9)[:, None]
    assert np.abs(dt).max() < 5e-3
    twist = true["twist"]
    ddt = np.gradient(twist, true["t_ns"] * 1e-9, axis=0)
    moved = twist * dt + 0.5 * ddt * dt * dt
    R = Rotation.from_rotvec(moved[:, 3:]) * Rotation.from_matrix(true["R"].reshape(-1, 3, 3))
    apart = R * Rotation.from_matrix(rows["R"].reshape(-1, 3, 3)).inv()
    off = np.linalg.norm(true["p"] + moved[:, :3] - rows["p"], axis=1)
    return 1e6 * float(off.max()), 1e3 * float(np.rad2deg(apart.magnitude()).max())


def measured(family: str, *, used: bool, jump: bool) -> dict[str, Any]:
    """Figures of one run of 10 s; jump: the encoder of leg 2 jumps by 2 mm."""
    c = bench(family, used=used)
    faults = FaultPlan([EncoderJump(leg=2, by_m=2e-3, at_s=5.0)] if jump else [], 1)
    with TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        summary = simulate(c, log=log, faults=faults, plant_log=True)
        rows, truth = Log(log).rows(), Log(summary["plant_log"]).rows()
    if not summary["replay"]["exact"]:
        raise RuntimeError(f"{family}: replay {summary['replay']}")
    rows = rows[rows["mode"] == Mode.TRACKING]
    position, rotation = pose_errors(rows, truth)
    return {
        "check_warnings": inspect(c).codes,
        "success": summary["success"],
        "ends": summary["trouble"],
        "position_um": position,
        "rotation_mdeg": rotation,
        "seconds": float(rows["t_ns"][-1] - rows["t_ns"][0]) * 1e-9,
    }


def main() -> None:
    """Run all cases and write their figures."""
    result = {
        family: {
            f"{'fused' if used else 'legs'}{', jump' * jump}": measured(family, used=used, jump=jump)
            for used in (False, True)
            for jump in (False, True)
        }
        for family in FAMILIES
    }
    Path(sys.argv[sys.argv.index("--json") + 1]).write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
