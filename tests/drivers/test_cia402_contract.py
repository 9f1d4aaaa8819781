"""CiA 402 drives fulfil the contract of a drive protocol; they reset, fault, lose the controller and stop."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.protocol import Frame, Received
from drivers.signals import LEGS, Command, DriveFault, DriveMode, DriveState
from hil.contracts.loopback import FORCE, OFF, PERIOD_NS, Ends
from hil.contracts.protocol import ProtocolContract
from hil.contracts.trouble import TroubleContract
from tests.drivers.cia402_drives import PERMILLE_N, STEP_m, drives

RUN = Command(DriveMode.RUN, FORCE)
READY = Command(DriveMode.READY, FORCE)
RESET = Command(DriveMode.RESET, np.zeros(LEGS))
HEARTBEAT = 0x77F


class TestCia402WithVelocity(TroubleContract):
    RESOLUTION = (STEP_m, STEP_m, PERMILLE_N, PERMILLE_N)
    LENGTHS = (-326.0, 327.0)
    """2^31 counts of 20 mm / 2^17 around 0.75 m."""
    SPEED = 327.0
    MOST_N = 10_000.0
    """Value of 0x6072 in the drive."""
    BEATS = "nothing"

    def beat_ids(self, protocol):
        return {0x701, 0x702, 0x703, 0x704, 0x705, 0x706}

    @pytest.fixture
    def family(self):
        return drives()


class TestCia402WithoutVelocity(ProtocolContract):
    RESOLUTION = (STEP_m, 1.5, PERMILLE_N, PERMILLE_N)
    READS_RATES = False
    """The legs of the contract are at rest but report a rate, which only a PDO carries."""

    @pytest.fixture
    def family(self):
        return drives((126, 20, 30, 40, 50, 1), velocity=False)


def states(ends: Ends) -> list[int]:
    return list(map(int, ends.measurement["drive_state"]))


def alone(ends: Ends, frames: Any, ticks: int) -> list[Frame]:
    """Step the drives for some ticks with these frames in each; the result is the frames that they send."""
    sent: list[Frame] = []
    for _ in range(ticks):
        ends.tick += 1
        t = ends.tick * PERIOD_NS
        sent += [frame for _, frame in ends.nodes.step(t, [Received(t, f) for f in frames])]
    return sent


def test_each_drive_faults_without_the_controllers_heartbeat_although_pdos_continue():
    ends = Ends(drives())
    ends.running()
    for _ in range(40):
        ends.step(RUN, set_up=False)
    assert states(ends) == [DriveState.RUN] * LEGS
    sent = alone(ends, [frame for frame in ends.sent if frame.id != HEARTBEAT], 30)
    for node in range(1, 7):
        assert Frame(0x080 + node, bytes.fromhex("3081110000000000")) in sent
    ends.to_controller = [Received(ends.tick * PERIOD_NS, frame) for frame in sent]
    ends.step(RUN, set_up=False)
    ends.step(RUN, set_up=False)
    assert states(ends) == [DriveState.FAULT] * LEGS
    assert ends.measurement["drive_fault"].tolist() == [0x8130] * LEGS
    assert "heartbeat" in ends.protocol.fault_text(0x8130)


def test_drive_stays_enabled_by_heartbeats_of_its_controller_only():
    ends = Ends(drives())
    ends.running()
    alone(ends, [Frame(HEARTBEAT, b"\x05")], 100)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.RUN] * LEGS
    alone(ends, [Frame(HEARTBEAT - 1, b"\x05")], 100)
    assert ends.nodes.snapshot().state.tolist() == [DriveState.FAULT] * LEGS


@pytest.mark.parametrize("runs", [True, False])
def test_emergency_stop_sent_together_with_off_lasts_until_a_reset(runs):
    ends = Ends(drives())
    if runs:
        ends.running()
    else:
        ends.until_set_up()
    stop = ends.protocol.traits.emergency_stop
    ends.step(OFF._replace(stop=True), set_up=False, first=stop)
    for command in (OFF, READY, READY, READY, RUN, RUN, *[OFF] * 30):
        ends.step(command, set_up=False)
        assert states(ends) == [DriveState.FAULT] * LEGS
        assert not runs or ends.measurement["drive_fault"].tolist() == [DriveFault.ESTOP] * LEGS
    assert ends.nodes.snapshot().brake.all()
    for _ in range(ends.protocol.traits.reset_ticks):
        ends.step(RESET, set_up=False)
    ends.step(set_up=False)
    assert states(ends) == [DriveState.OFF] * LEGS
    assert not ends.measurement["drive_fault"].any()


def test_drive_gives_force_only_in_run_which_it_cannot_enter_directly_from_off():
    ends = Ends(drives())
    ends.until_set_up()
    for command, state in ((RUN, DriveState.OFF), (READY, DriveState.READY)):
        for _ in range(8):
            ends.step(command, set_up=False)
        assert states(ends) == [state] * LEGS
        assert not ends.nodes.snapshot().force.any()
        assert not ends.measurement["drive_force"].any()
    ends.step(RUN, set_up=False)
    np.testing.assert_allclose(ends.nodes.snapshot().force, FORCE, rtol=0, atol=1.5)
