"""ODrive CAN Simple 0.6: the contract, bytes of the vendor's own headers, and settings."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.protocol import REMOTE, Frame
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.drives_end import reports
from hil.contracts.ends import SETUP
from hil.contracts.messages import Configure, Status
from hil.contracts.trouble import TroubleContract
from tests.drivers.motor_families import ODRIVE_NODES as NODES
from tests.drivers.motor_families import UNIT, odrive

VECTORS = json.loads((Path(__file__).parents[1] / "data/drives/odrive.json").read_text("utf-8"))["vectors"]
BRAKES = SETUP._replace(reaction=Reaction.BRAKE)
P = odrive(UNIT)


class TestODrive(TroubleContract):
    RESOLUTION = (1e-7, 1e-6, None, 1e-3)
    SETS_WATCHDOG = TELLS_BOOT = ENDS = False
    LENGTHS, SPEED, RELATIVE = (-100.0, 100.0), 100.0, 1e-7
    BEATS, OTHER = "state", 0x200

    def beat_ids(self, protocol):
        return {node << 5 | 1 for node in NODES}

    @pytest.fixture
    def family(self):
        return odrive()


def vectors(name: str) -> list[Any]:
    found = [each for each in VECTORS if each["what"] == f"0.6: {name}"]
    assert found
    return found


def frame(v: Any) -> Frame:
    return Frame(v["id"], bytes.fromhex(v["data"]))


def told(dialogue: Remembered, mode: DriveMode, tick: int = 0) -> list[list[Frame]]:
    """Return the frames of a tick's command to each axis."""
    _, frames = P.command(dialogue, Command(mode, np.zeros(6)), tick)
    return [[frame for frame in frames if frame.id >> 5 == node] for node in NODES]


def running(torque: float) -> Remembered:
    return P.start(BRAKES)._replace(mode=DriveMode.RUN, ran=(True,) * 6, torque=(torque,) * 6)


def test_states_modes_errors_and_stops_are_the_vendors_frames():
    start = P.start(BRAKES)
    for sent, name in (
        (told(start, DriveMode.RUN)[3][0], "Set_Axis_State"),
        (told(start._replace(power=(DriveState.OFF,) * 6), DriveMode.READY)[0][0], "Set_Controller_Mode"),
        (told(start, DriveMode.RESET)[1][1], "Clear_Errors"),
        (P.traits.emergency_stop[1], "Estop"),
        (reports(P, Status(0, DriveState.OFF, DriveFault.NONE))[0], "Heartbeat"),
    ):
        assert sent == frame(vectors(name)[0])
    assert P.begin(start, 0)[1] == Frame(vectors("Get_Encoder_Estimates")[0]["id"], b"", REMOTE)


def test_each_axis_is_told_by_its_own_state():
    power = tuple(
        map(int, (DriveState.RUN, DriveState.OFF, DriveState.FAULT, DriveState.OFF, DriveState.RUN, 0))
    )
    state, modes, clear, torque = 0x07, 0x0B, 0x18, 0x0E
    for mode, kinds in (
        (DriveMode.OFF, [[state]] * 6),
        (DriveMode.READY, [[state], [modes], [state], [modes], [state], [state]]),
        (DriveMode.RUN, [[state, torque]] * 6),
        (DriveMode.RESET, [[state, clear]] * 6),
    ):
        found = told(P.start(BRAKES)._replace(power=power), mode)
        assert [[frame.id & 0x1F for frame in frames] for frames in found] == kinds


# settings


def made(layout: Any = "classic", **changes: Any) -> Any:
    values = {"protocol": "odrive", "transmission": {"lead_m": 0.02}, "force_limit_N": 5}
    return build_protocol(BusSettings(layout=layout), DriveSettings.model_validate(values | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"transmission": None}, r"drives\.transmission: protocol odrive"),
        ({"layout": "fd"}, r"bus\.layout: .*given: fd"),
        *(({"node_ids": [1, 2, 3, 4, 5, n]}, rf"node_ids\[5\]: .*0 to 62, given: {n}") for n in (-1, 63)),
        ({"options": {"gain": 1}}, "given: gain"),
        *(({"options": {"encoder_msg_rate_ms": n}}, f"0 to 10000, given: {n}") for n in (-1, 10_001, 2.5)),
        ({"heartbeat_ms": 250.5}, r"drives\.heartbeat_ms: .*up to 250"),
        ({"transmission": {"lead_m": 2000.0}, "force_limit_N": 60}, r"carries up to 10000 N m"),
    ],
)
def test_setting_that_does_not_fit_is_refused_by_name(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        made(**changes)


def test_settings_reach_the_codec_and_an_axis_sends_estimates_every_10_ms_as_delivered():
    named = made(
        heartbeat_ms=125, watchdog_ms=40, options={"encoder_msg_rate_ms": 4}, node_ids=[7, 2, 0, 4, 5, 62]
    )
    assert named.traits.feedback_ids == {node << 5 | 9 for node in (7, 2, 0, 4, 5, 62)}
    unasked = [made(options=options).traits.unasked_s for options in ({}, {"encoder_msg_rate_ms": 0})]
    assert [named.traits.unasked_s, *unasked] == pytest.approx([0.004, 0.01, 0.0])
    assert made(heartbeat_ms=250, options={"encoder_msg_rate_ms": 10_000}).traits.unasked_s == 10.0
    protocol = ByValue(named)
    dialogue: Any = protocol.start(BRAKES._replace(watchdog_s=0.04))
    assert dialogue.patience_ticks == 94, "three heartbeats of 0.125 s, whole ticks"
    idle = Frame(2 << 5 | 0x07, struct.pack("<Ixxxx", 1))
    _, messages = protocol.parse(protocol.power_up(), idle)
    (delivered,) = [each for each in messages if isinstance(each, Configure)]
    assert delivered.leg == 1
    assert delivered.watchdog_s == pytest.approx(0.04)
    assert [made(heartbeat_ms=ms).patience_ticks(251.0) for ms in (100, 1, 4.1)] == [76, 2, 4]
    assert "mechanical_brake.config.gpio_num" in named.traits.dangers[0]
