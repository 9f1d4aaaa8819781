"""Load cells between drives and rods: friction and external wrench without the drives' own losses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import Mode
from hil.app.sim.command import simulate
from hil.lab.identify.payload import drives_of, identify_payload
from hil.record.log import Log
from plant_fmu.faults.kinds import WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.loop.bench import changed
from tests.loop.test_sensor_families import OWN_BUS, SHORT

TRUE = {"viscous_friction_N_s_m": 20.0, "coulomb_friction_N": 3.0, "reflected_mass_kg": 4.5}
"""The plant of configs/desktop.yaml."""
LOAD_N = 20.0
OFF_NOMINAL = {"coulomb_friction_N": 6.0, "viscous_friction_N_s_m": 40.0}


def desktop(*, cells: bool, **sections: Any) -> Any:
    """`desktop`, with load cells of 0.2 N on a second bus or without."""
    device = {"protocol": "cia404", "trigger": "cyclic", "format": "float32", "latency_ms": 0.6}
    forces = {"node_ids": [*range(21, 27)], "rate_Hz": 200, "channel": "sensors0", "device": device}
    own = {
        "bus": OWN_BUS,
        "sensors": {"forces": forces},
        "plant": {"sensors": {"forces": {"noise_N": 0.2, "latency_ms": 0.5}}},
    }
    c = changed("desktop", **SHORT, **(own if cells else {}))
    return changed(c, **sections)


def test_load_cells_keep_an_unknown_push_out_of_the_drives_friction(tmp_path):
    errors = {}
    push = FaultPlan([WrenchStep(force_N=(8, 0, -8), at_s=6.0)], 0)
    for cells in (False, True):
        log = tmp_path / f"{cells}.mcap"
        assert simulate(desktop(cells=cells), log=log, check_replay=False, faults=push)["success"]
        found = drives_of(identify_payload([log]))
        for key, true in TRUE.items():
            errors[key, cells] = float(np.sqrt(np.mean((found[key][0] - true) ** 2)))
    for key in TRUE:
        assert errors[key, True] < 0.2 * errors[key, False], errors


def wrench_error(c: Any, tmp_path: Any) -> float:
    """Rms error, N, of the estimated force on the platform against the plant's, while it moves."""
    step = FaultPlan([WrenchStep(force_N=(0, 0, -LOAD_N), at_s=4.0)], 0)
    summary = simulate(
        c,
        log=tmp_path / f"{c.estimation.wrench.forces}.mcap",
        faults=step,
        duration_s=8.0,
        plant_log=True,
        check_replay=False,
    )
    assert summary["success"], summary["trouble"]
    rows, truth = Log(summary["log"]).rows(), Log(summary["plant_log"]).rows()
    kept = (rows["mode"] == Mode.TRACKING) & (np.abs(rows["t_ns"] * 1e-9 - 4.0) > 0.2)
    true = truth["wrench"][np.searchsorted(truth["tick"], rows["tick"][kept])]
    return float(np.sqrt(np.mean(np.sum((rows["wrench"][kept, :3] - true[:, :3]) ** 2, axis=1))))


def test_load_cells_take_the_friction_off_the_external_wrench(tmp_path):
    friction = {"plant": {"model": OFF_NOMINAL}}
    observer = {"source": "observer", "bandwidth_Hz": 10, "bus_ms": 2, "drive_lag_ms": 0.8}
    sent = wrench_error(desktop(cells=True, estimation={"wrench": observer}, **friction), tmp_path)
    measured = wrench_error(
        desktop(cells=True, estimation={"wrench": observer | {"forces": "sensors"}}, **friction), tmp_path
    )
    assert measured < 0.2 * sent
    assert measured < 0.05 * LOAD_N


def test_observer_keeps_its_estimate_while_a_load_cell_is_silent(tmp_path):
    observer = {"source": "observer", "forces": "sensors", "bus_ms": 2, "drive_lag_ms": 0.8}
    lost = {"kind": "sensor_lost", "sensor": "force_3", "at_s": 3.0}
    c = desktop(cells=True, estimation={"wrench": observer}, plant={"faults": [lost]})
    assert simulate(c, log=tmp_path / "run.mcap", duration_s=5.0)["replay"]["exact"]
    rows = Log(tmp_path / "run.mcap").rows()
    late = rows["wrench"][rows["t_ns"] > 3_100_000_000]
    moving = late[rows["mode"][rows["t_ns"] > 3_100_000_000] == Mode.TRACKING]
    assert len(moving) > 200
    assert np.ptp(moving, axis=0).max() == 0.0


def test_observer_by_load_cells_needs_load_cells_and_the_observer():
    for sections in ({}, {"sensors": {"forces": None}}):
        wrench = {"forces": "sensors"} | ({"source": "observer"} if sections else {})
        with pytest.raises(ConfigurationError, match=r"estimation\.wrench\.forces"):
            desktop(cells=True, estimation={"wrench": wrench}, **sections)
