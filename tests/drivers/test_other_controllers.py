"""What another controller on the bus says to motor drives is heard as foreign, and what is nobody's is not."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.mit.fields import Ranges
from drivers.moteus import STOP
from drivers.protocol import BRS, EXTENDED, FD, Frame
from drivers.signals import Reaction
from tests.drivers.motor_families import MitProtocol, MoteusProtocol, ODriveProtocol, RobStrideProtocol
from tests.drivers.test_odrive import GEAR, NODES

RANGES = Ranges(95.5, 400.0, 144.0)
ROBSTRIDE = RobStrideProtocol(RANGES, (1, 2, 3, 4, 5, 127), 253, GEAR)
ODRIVE = ODriveProtocol(NODES, 0.05, GEAR)
MOTEUS = MoteusProtocol((1, 2, 3, 4, 5, 126), 0, Reaction.DAMP, 2.0, GEAR)
SET_POINTS = [0x02, 0x04, 0x06, 0x07, 0x0B, 0x0C, 0x0D, 0x0E, 0x0F, 0x11, 0x12, 0x13, 0x16, 0x18]
SETTINGS = [0x19, 0x1A, 0x1B, 0x1F]
"""Absolute position, gains, firmware update: what CAN Simple has a controller send beside set points."""
SAID = [0x01, 0x03, 0x05, 0x09, 0x14, 0x15, 0x17, 0x1C, 0x1D]
"""What an axis sends."""


def mit(variant: str) -> Any:
    host = 16 if variant == "damiao" else 0
    return MitProtocol(variant, RANGES, (1, 2, 3, 4, 5, 15), host, GEAR)


@pytest.mark.parametrize("request_", [0x33, 0x55, 0xCC, 0xAA], ids=["read", "write", "refresh", "save"])
def test_a_register_request_to_any_damiao_is_foreign(request_):
    for node in (1, 2, 3, 4, 5, 15):
        heard = mit("damiao").hear(Frame(0x7FF, bytes((node, 0, request_, 9, 1, 0, 0, 0))))
        assert heard is not None
        assert heard.foreign


@pytest.mark.parametrize("variant", ["mini_cheetah", "cubemars"])
def test_the_identifier_of_damiaos_registers_is_nobodys_with_other_variants(variant):
    assert mit(variant).hear(Frame(0x7FF, bytes((1, 0, 0x55, 9, 1, 0, 0, 0)))) is None


@pytest.mark.parametrize("variant", ["mini_cheetah", "cubemars", "damiao"])
def test_a_command_to_any_drive_with_mit_framing_is_foreign(variant):
    for leg, node in enumerate((1, 2, 3, 4, 5, 15)):
        heard = mit(variant).hear(Frame(node, bytes(8)))
        assert (heard.leg, heard.foreign) == (leg, True)


@pytest.mark.parametrize("kind", [1, 3, 4, 17, 18], ids=["control", "enable", "stop", "read", "write"])
@pytest.mark.parametrize("host", [253, 0xAA])
def test_a_command_to_any_robstride_is_foreign_whatever_it_asks(kind, host):
    for leg, node in enumerate((1, 2, 3, 4, 5, 127)):
        data = struct.pack("<HxxI", 0x7005, 0)
        heard = ROBSTRIDE.hear(Frame(kind << 24 | host << 8 | node, data, EXTENDED))
        assert heard is not None
        assert (heard.leg, heard.foreign) == (leg, True)


@pytest.mark.parametrize("kind", SET_POINTS + SETTINGS)
def test_all_that_a_controller_sends_to_an_axis_is_foreign(kind):
    for leg, node in enumerate(NODES):
        # a node number of 0xFF: a setting of the address, no answer with it
        heard = ODRIVE.hear(Frame(node << 5 | kind, b"\xff" + bytes(7)))
        assert heard is not None
        assert (heard.leg, heard.foreign) == (leg, True)


@pytest.mark.parametrize("kind", SAID)
def test_what_an_axis_says_itself_is_not_foreign(kind):
    for node in NODES:
        heard = ODRIVE.hear(Frame(node << 5 | kind, bytes(8)))
        assert heard is None or not heard.foreign


@pytest.mark.parametrize("prefix", [1, 2, 0x7FF, 0x1FFF])
def test_a_moteus_frame_with_a_prefix_is_of_another_group_of_drives(prefix):
    for node in (1, 2, 3, 4, 5, 126, 0x7F):
        for identifier in (node, 0x8000 | node, 0x8500 | node):
            frame = Frame(prefix << 16 | identifier, STOP, EXTENDED | FD | BRS)
            assert MOTEUS.hear(frame) is None
            ours = MOTEUS.hear(
                frame._replace(id=identifier, flags=FD | BRS | EXTENDED * (identifier > 0x7FF))
            )
            assert ours is not None
            assert ours.foreign
