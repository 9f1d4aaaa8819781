"""The row of CiA 402: its bus time, the keys that it checks, and the data sheet of a drive."""

from __future__ import annotations

import sys
from math import ceil
from typing import Any

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.cia402.objects import check_eds
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.protocol import DriveSetup
from drivers.registry import loaded
from drivers.signals import Command, DriveMode, Reaction
from hil.app.configuration.bus_budget import budget
from hil.contracts.by_value import ByValue
from tests.drivers.cia402_drives import PERMILLE_N, drives, settings
from tests.drivers.cia402_sheet import sheet

OPTIONS: dict[str, str | int | float | bool] = {"rated_torque_Nm": 9.0}


def made(*, layout="classic", transmission=None, **options):
    bus = BusSettings(layout=layout)
    screw = settings() if transmission is None else transmission
    found = DriveSettings(protocol="cia402", options=OPTIONS | options, transmission=screw)
    return loaded("hil.protocols", "cia402")(bus, found)


@pytest.mark.parametrize(
    ("velocity", "buses", "rate"),
    [
        (False, 1, 487.8),
        (False, 2, 939.6),
        (False, 3, 1359.2),
        (True, 1, 349.1),
        (True, 2, 679.6),
        (True, 3, 992.9),
    ],
)
def test_the_rate_that_a_bus_of_1_Mbit_s_carries_at_70_percent(velocity, buses, rate):
    """SYNC 55 bit; a leg: RPDO of 4 bytes 95, TPDO of 8 bytes 135, one with the velocity 95 more."""
    protocol = drives(velocity=velocity)
    frames = []
    for frame in protocol.traits.cyclic_frames:
        node = frame.id & 0x7F
        frames += [frame] * (node == 0 or (node - 1) % buses == 0)
    found = budget(frames, BitTiming(1_000_000, 1_000_000), 100.0)
    by_hand = 0.7e6 / (55 + 6 // buses * (95 + 135 + 95 * velocity))
    assert found.allowed_rate_Hz == pytest.approx(by_hand)
    assert found.allowed_rate_Hz == pytest.approx(rate, abs=0.05)


def test_a_configuration_makes_the_codec():
    protocol = ByValue(made(velocity="difference", controller_node=100))
    assert not protocol.velocity
    off = Command(DriveMode.OFF, np.zeros(6))
    _, frames = protocol.command(protocol.start(DriveSetup(0.04, Reaction.BRAKE, 250.0)), off, 0)
    assert frames[-1].id == 0x700 + 100
    assert len(protocol.traits.feedback_ids) == 6
    assert len(protocol.traits.dangers) == 2
    assert len(made().traits.dangers) == 1


def test_each_setting_of_the_drives_reaches_the_object_that_it_is_for():
    own: dict[str, Any] = {
        "node_ids": [9, 8, 7, 6, 5, 4],
        "heartbeat_ms": 35.0,
        "watchdog_ms": 20.0,
        "force_limit_N": 500.0,
    }
    found = DriveSettings(protocol="cia402", options=OPTIONS, transmission=settings(), **own)
    protocol = loaded("hil.protocols", "cia402")(BusSettings(layout="classic"), found)
    plans = ByValue(protocol).plans(DriveSetup(0.04, Reaction.BRAKE, 250.0))
    told = [{s.key: s.value for s in plan if s.kind == "write"} for plan in plans]
    assert [each[0x1017, 0] for each in told] == [35] * 6
    assert [each[0x1016, 1] for each in told] == [127 << 16 | 40] * 6
    assert [each[0x1800, 1] for each in told] == [0x180 + node for node in own["node_ids"]]
    assert [each[0x6072, 0] for each in told] == [ceil(500.0 / PERMILLE_N)] * 6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"layout": "fd"}, r"bus\.layout: allowed with cia402: classic.*given: fd"),
        ({"rated_torque_Nm": 0.0}, r"drives\.options: rated_torque_Nm of protocol cia402: .*given: 0\.0"),
        (
            {"rated_torque_Nm": 0.000999},
            r"drives\.options: rated_torque_Nm of protocol cia402: .*given: 0\.000999",
        ),
        ({"rated_torque_Nm": 4_294_967.5}, r"rated_torque_Nm of .*0\.001 to 4294967, .*given: 4294967\.5"),
        ({"rated_torque_Nm": True}, r"drives\.options: rated_torque_Nm of protocol cia402: .*given: True"),
        (
            {"velocity": "both"},
            r"drives\.options: velocity of protocol cia402: allowed: one of pdo, difference, given: both",
        ),
        ({"controller_node": 128}, r"drives\.options: controller_node of protocol cia402: .*given: 128"),
        ({"controller_node": 0}, r"drives\.options: controller_node of protocol cia402: .*given: 0"),
        ({"controller_node": True}, r"drives\.options: controller_node of protocol cia402: .*given: True"),
        ({"controller_node": 9.0}, r"drives\.options: controller_node of protocol cia402: .*given: 9\.0"),
        ({"controller_node": 1}, r"drives\.node_ids\[0\]: .*given: 1"),
        ({"controller_node": 3}, r"drives\.node_ids\[2\]: .*given: 3"),
        (
            {"check_encoder": 1},
            r"drives\.options: check_encoder of protocol cia402: allowed: true, false, given: 1",
        ),
        ({"speed": 1}, r"drives\.options: protocol cia402 has rated_torque_Nm, .*given: speed"),
    ],
)
def test_a_key_that_does_not_fit_is_refused_by_name(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        made(**changes)


@pytest.mark.parametrize("rated_Nm", [1e-3, 4_294_967.0])
def test_a_rated_torque_is_a_thousandth_of_a_newton_metre_to_what_its_object_can_say(rated_Nm):
    assert made(rated_torque_Nm=rated_Nm).rated_torque_mNm == round(1e3 * rated_Nm)


def test_the_encoder_is_checked_unless_the_configuration_says_not_to():
    found = [
        made(**options)._increments for options in ({}, {"check_encoder": True}, {"check_encoder": False})
    ]
    assert found == [[131072] * 6, [131072] * 6, [0] * 6]


def test_it_needs_a_transmission_and_a_rated_torque():
    with pytest.raises(ConfigurationError, match=r"drives\.transmission: protocol cia402 speaks of motors"):
        loaded("hil.protocols", "cia402")(
            BusSettings(layout="classic"), DriveSettings(protocol="cia402", options=OPTIONS)
        )
    with pytest.raises(ConfigurationError, match=r"rated_torque_Nm of .*given: nothing"):
        loaded("hil.protocols", "cia402")(
            BusSettings(layout="classic"), DriveSettings(protocol="cia402", transmission=settings())
        )


def test_a_data_sheet_that_has_all_is_taken(tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(sheet(), encoding="ascii")
    for velocity in (True, False):
        check_eds(str(path), velocity=velocity)


def test_a_codec_opens_no_data_sheet(tmp_path):
    """A replay builds it, too, and reads nothing that a log names."""
    made(eds=str(tmp_path / "nowhere.eds"))


def test_a_data_sheet_names_all_that_the_drive_lacks(tmp_path):
    path = tmp_path / "drive.eds"
    text = sheet(0x605E, 0x1801)
    mode = text.index("[6060]")
    text = text[:mode] + text[mode:].replace("AccessType=rw", "AccessType=ro", 1)
    torque = text.index("[6077]")
    text = text[:torque] + text[torque:].replace("PDOMapping=1", "PDOMapping=0", 1)
    path.write_text(text, encoding="ascii")
    with pytest.raises(ConfigurationError) as refused:
        check_eds(str(path), velocity=True)
    for lack in (
        "0x605E:0 fault reaction option code is not there",
        "0x1801:1 is not there",
        "0x6060:0 mode of operation cannot be written",
        "0x6077:0 cannot be mapped",
    ):
        assert lack in str(refused.value)
    with pytest.raises(ConfigurationError) as refused:
        check_eds(str(path), velocity=False)
    assert "0x1801" not in str(refused.value)


def test_without_the_package_a_data_sheet_is_refused_with_what_to_install(monkeypatch, tmp_path):
    path = tmp_path / "drive.eds"
    path.write_text(sheet(), encoding="ascii")
    monkeypatch.setitem(sys.modules, "canopen", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'hexapod-hil\[canopen\]'"):
        check_eds(str(path), velocity=True)
