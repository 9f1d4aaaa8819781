"""Encoders that lose their count of motor turns at power-off."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.config import DriveSettings, HomingSettings, TransmissionSettings
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Received
from drivers.tick_columns import new_record
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.drive import forgotten_m
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.kinds import DriveReset
from plant_fmu.faults.plan import FaultPlan
from tests.drivers.legs_frames import decode, opening
from tests.plant_fmu.rig import MS, REST, Masses

LEADS = np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06])
GEAR = TransmissionSettings(lead_m=LEADS.tolist(), sign=[1, -1, 1, -1, 1, -1], offset_m=0.003)
FORGETS = np.array([1.0, 0.5, 1.0, 2.0, 1.0, 0.25])
HOMING = HomingSettings(file="homing.yaml", limit_m=1e-3, forgotten_turns=FORGETS.tolist())


def turns_of(length: np.ndarray) -> np.ndarray:
    return Transmission(GEAR).turns(length)


def test_each_encoder_loses_a_whole_multiple_of_the_turns_its_drive_forgets_at_power_off():
    counted = turns_of(REST - forgotten_m(HOMING, Transmission(GEAR), REST))
    assert (np.abs(counted) <= FORGETS / 2 + 1e-9).all()
    forgotten = (turns_of(REST) - counted) / FORGETS
    np.testing.assert_allclose(forgotten, np.round(forgotten), rtol=0, atol=1e-9)
    assert (np.abs(forgotten) > 10).all()


class Moving(Masses):
    """Legs that extend by 0.1 m/s despite force and brake."""

    def step(self, force, brake, wrench, dt_s):
        self.q = self.q + 0.1 * dt_s
        return self.q, np.full(6, 0.1)


def test_drive_restarted_in_motion_loses_the_encoder_turns_counted_before_the_restart():
    protocol = LegsProtocol("ideal", (1, 2, 3, 4, 5, 6))
    settings = DriveSettings(transmission=GEAR, homing=HOMING)
    faults = FaultPlan([DriveReset(leg=4, at_s=0.5)])
    nodes = Nodes(Moving(), protocol, DriveEmulation(encoder_resolution_m=0.0), settings, faults)
    nodes.start(0)
    seen = []
    for tick, t_ms in enumerate((499, 501)):
        sent = nodes.step(t_ms * MS, [Received(t_ms * MS, opening(protocol, tick)[0])])
        received = [Received(t, frame) for t, frame in sent]
        seen.append(decode(protocol, received, tick, new_record())["length"].copy())
    steps = seen[1] - seen[0]
    np.testing.assert_allclose(np.delete(steps, 4), 0.1 * 2e-3, rtol=0, atol=1e-12)
    assert steps[4] == pytest.approx(0.1 * 2e-3 - LEADS[4], abs=1e-12), "the leg has moved one turn by then"
