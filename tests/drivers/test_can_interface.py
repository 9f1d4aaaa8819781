"""A CAN interface through netlink: request and answer, comparison with the configuration, error frames.

Bytes are written by hand after linux/rtnetlink.h, linux/if_link.h, linux/can/netlink.h and linux/can/error.h.
"""

from __future__ import annotations

import sys
from typing import Any

import pytest

from drivers.can import netlink
from drivers.can.can_interface import parse, read_error, refusal
from drivers.config import BusSettings
from drivers.signals import BusState

pytestmark = pytest.mark.skipif(sys.byteorder != "little", reason="byte vectors are little endian")

LINK = "0000 1801 05000000 c1000100 00000000"
"""struct ifinfomsg: ARPHRD_CAN, index 5, up."""
NAME, QUEUE, MTU = "0900 0300 63616e3000 000000", "0800 0d00 0a000000", "0800 0400 48000000"
BITTIMING = "2400 0100 40420f00 ee020000 0c000000 1d000000 1e000000 14000000 0a000000 01000000"
STATE, CTRLMODE, RESTART = "0800 0400 02000000", "0c00 0500 23000000 20000000", "0800 0600 64000000"
COUNTERS = "0800 0800 8000 7f00"
DATA_BITTIMING = "2400 0900 404b4c00" + "00000000" * 7
DATA = f"7000 0280 {BITTIMING} {STATE} {CTRLMODE} {RESTART} {COUNTERS} {DATA_BITTIMING}"
CAN0 = bytes.fromhex(f"{LINK} {NAME} {QUEUE} {MTU} 7c00 1200 0800 0100 63616e00 {DATA}")
VCAN0 = bytes.fromhex(f"{LINK} {MTU} 1000 1200 0900 0100 7663616e00 000000")


def can0(**changes):
    return parse("can0", CAN0)._replace(**{"state": BusState.ACTIVE, **changes})


def settings(**changes):
    return BusSettings.model_validate({"interface": "socketcan", "channel": "can0", **changes})


def test_state_and_bit_rates_of_a_can_controller_are_read_from_the_netlink_answer():
    found = parse("can0", CAN0)
    assert found[:6] == ("can0", 5, True, 72, "can", True)
    assert found[6:] == (1_000_000, 5_000_000, BusState.PASSIVE, 100, 0x20, (128, 127))
    assert "1000000 bit/s, data 5000000 bit/s, state PASSIVE, restart-ms 100" in found.facts


def test_virtual_can_interface_is_not_compared_with_the_configured_bit_rates():
    found = parse("vcan0", VCAN0)
    assert (found.kind, found.has_controller, refusal(found, settings())) == ("vcan", False, "")
    assert "nothing was compared" in found.facts
    assert "restart_ms" in refusal(found, settings(options={"restart_ms": 0}))


@pytest.mark.parametrize("cut", range(16, len(CAN0), 3))
def test_truncated_netlink_answer_is_read_up_to_its_end(cut):
    assert parse("can0", CAN0[:cut]).number == 5


@pytest.mark.parametrize(
    ("number", "state"), [(0, "ACTIVE"), (1, "WARNING"), (2, "PASSIVE"), (3, "OFF"), (4, "UNKNOWN")]
)
def test_states_of_a_can_controller_are_numbered_as_in_the_kernels_enum_can_state(number, state):
    raw = CAN0.replace(bytes.fromhex(STATE), bytes.fromhex(f"0800 0400 0{number}000000"))
    assert parse("can0", raw).state is BusState[state]


def test_can_interface_that_matches_the_configuration_is_accepted():
    assert refusal(can0(), settings()) == ""
    assert refusal(can0(), settings(layout="classic", options={"restart_ms": 100})) == ""
    # an adapter that was not set up through the kernel
    assert refusal(can0(bitrate_bit_s=None), settings(layout="classic")) == ""
    # classic frames do not use the second rate
    assert refusal(can0(data_bitrate_bit_s=2_000_000, modes=0), settings(layout="classic")) == ""


@pytest.mark.parametrize(
    ("changes", "wanted", "words"),
    [
        ({"bitrate_bit_s": 500_000}, {}, ["500000", "bus.bitrate_bit_s is 1000000", "bitrate 1000000"]),
        ({"data_bitrate_bit_s": 2_000_000}, {}, ["2000000", "bus.data_bitrate_bit_s is 5000000"]),
        ({}, {"options": {"restart_ms": 0}}, ["restart-ms 100", "bus.options.restart_ms is 0"]),
        ({"modes": 0}, {}, ["classic CAN only", "fd on"]),
        ({"mtu": 16}, {}, ["classic CAN only", "mtu 72"]),
        ({"modes": 0x22}, {}, ["listen-only"]),
        ({"modes": 0x21}, {}, ["loopback"]),
        ({"state": BusState.OFF}, {}, ["bus-off", "restart"]),
        ({"up": False}, {}, ["is down", "up"]),
    ],
)
def test_can_interface_unlike_the_configuration_is_refused_with_both_values(changes, wanted, words):
    why = refusal(can0(**changes), settings(**wanted))
    assert all(word in why for word in words), why


def test_all_differences_of_a_can_interface_from_the_configuration_are_reported_at_once():
    found = can0(bitrate_bit_s=500_000, data_bitrate_bit_s=2_000_000, modes=0x23)
    why, fix = refusal(found, settings(options={"restart_ms": 0})).split(": ", 1)
    assert len(why.split("; ")) == 5
    assert "bitrate 1000000 dbitrate 5000000 restart-ms 0 listen-only off loopback off" in fix


# error frames


@pytest.mark.parametrize(
    ("identifier", "data", "state", "overflow"),
    [
        (0x040, "", "OFF", False),
        (0x044, "0020", "OFF", False),
        (0x004, "0010", "PASSIVE", False),
        (0x004, "0020", "PASSIVE", False),
        (0x004, "002c", "PASSIVE", False),
        (0x004, "0004", "WARNING", False),
        (0x004, "0008", "WARNING", False),
        (0x004, "0040", "ACTIVE", False),
        (0x100, "", "ACTIVE", False),
        (0x104, "0010", "PASSIVE", False),
        (0x004, "0001", "UNKNOWN", True),
        (0x004, "0002", "UNKNOWN", False),
        (0x204, "0005000000006003", "WARNING", True),
        (0x008, "0031", "UNKNOWN", False),  # byte 1 is about the controller only in its class
        (0x088, "0020020000000000", "UNKNOWN", False),
        (0x004, "00", "UNKNOWN", False),
        (0x080, "", "UNKNOWN", False),
    ],
)
def test_error_frame_gives_the_can_controller_state_and_overflow(identifier, data, state, overflow):
    assert read_error(identifier | 0x400, bytes.fromhex(data)) == (BusState[state], overflow)


# what the kernel is asked


def queue(index: int, parent: str, length: int) -> bytes:
    """Payload of an RTM_NEWQDISC for a queue in which `length` frames wait."""
    statistics = f"1800 0300 {length:02x}000000 a8000000 00000000 00000000 00000000"
    options = f"0a00 0100 706c756700 00 0000 1c00 0700 {statistics}"
    return bytes.fromhex(f"00000000 {index:02x}000000 00000180 {parent} 02000000 {options}")


def test_frames_queued_for_sending_are_counted_in_the_root_queues_of_one_interface(monkeypatch):
    asked: list[Any] = []

    def request(*given: Any) -> list[bytes]:
        asked.append(given)
        return [queue(5, "ffffffff", 7), queue(6, "ffffffff", 30), queue(5, "01000180", 60)]

    monkeypatch.setattr(netlink, "request", request)
    assert netlink.queued(5) == 7
    assert asked == [(38, 0x300, bytes.fromhex("0000000005000000" + "0" * 24))]
