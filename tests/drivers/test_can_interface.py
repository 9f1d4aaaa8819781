"""A CAN interface by netlink, its comparison with the configuration, and error frames.

Bytes are written by hand after linux/rtnetlink.h, linux/if_link.h, linux/can/netlink.h and linux/can/error.h.
"""

from __future__ import annotations

import sys

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


def test_a_controller_is_read_from_the_kernels_answer():
    found = parse("can0", CAN0)
    assert found[:6] == ("can0", 5, True, 72, "can", True)
    assert found[6:] == (1_000_000, 5_000_000, BusState.PASSIVE, 100, 0x20, (128, 127))
    assert found.facts == (
        "can0: 1000000 bit/s, data 5000000 bit/s, state PASSIVE, restart-ms 100, "
        "error counters 128 (tx) and 127 (rx)"
    )


def test_a_virtual_interface_has_no_controller_and_says_that_nothing_was_compared():
    found = parse("vcan0", VCAN0)
    assert found.kind == "vcan"
    assert not found.has_controller
    assert "no bit rate" in found.facts
    assert "nothing was compared" in found.facts
    assert refusal(found, settings()) == ""


@pytest.mark.parametrize("cut", range(16, len(CAN0), 3))
def test_a_cut_answer_is_read_as_far_as_it_goes(cut):
    assert parse("can0", CAN0[:cut]).number == 5


@pytest.mark.parametrize(
    ("number", "state"), [(0, "ACTIVE"), (1, "WARNING"), (2, "PASSIVE"), (3, "OFF"), (4, "UNKNOWN")]
)
def test_states_are_those_of_enum_can_state(number, state):
    raw = CAN0.replace(bytes.fromhex(STATE), bytes.fromhex(f"0800 0400 0{number}000000"))
    assert parse("can0", raw).state is BusState[state]


@pytest.mark.parametrize("unknown", ["00000000", "ffffffff"])
def test_a_bit_rate_that_was_set_past_the_kernel_is_unknown(unknown):
    raw = CAN0.replace(bytes.fromhex("2400 0100 40420f00"), bytes.fromhex(f"2400 0100 {unknown}"))
    assert parse("can0", raw).bitrate_bit_s is None


def test_the_interface_that_the_configuration_means_is_not_refused():
    assert refusal(can0(), settings()) == ""
    assert refusal(can0(), settings(layout="classic", options={"restart_ms": 100})) == ""
    # an adapter that was set up past the kernel
    assert refusal(can0(bitrate_bit_s=None), settings(layout="classic")) == ""
    # classic frames do not use the second rate
    assert refusal(can0(data_bitrate_bit_s=2_000_000, modes=0), settings(layout="classic")) == ""


@pytest.mark.parametrize(
    ("changes", "asked", "words"),
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
def test_another_interface_is_refused_with_both_values_and_the_command_that_mends_it(changes, asked, words):
    why = refusal(can0(**changes), settings(**asked))
    assert all(word in why for word in words), why


def test_all_that_an_interface_has_otherwise_is_said_at_once():
    found = can0(bitrate_bit_s=500_000, data_bitrate_bit_s=2_000_000, modes=0x23)
    why, mend = refusal(found, settings(options={"restart_ms": 0})).split(": ", 1)
    assert why.split("; ") == [
        "runs at bitrate 500000, bus.bitrate_bit_s is 1000000",
        "runs at dbitrate 2000000, bus.data_bitrate_bit_s is 5000000",
        "has restart-ms 100, bus.options.restart_ms is 0",
        "only listens (listen-only on)",
        "sends to itself alone (loopback on)",
    ]
    assert "bitrate 1000000 dbitrate 5000000 restart-ms 0 listen-only off loopback off" in mend


def test_a_restart_time_is_refused_where_there_is_no_controller():
    assert "restart_ms" in refusal(parse("vcan0", VCAN0), settings(options={"restart_ms": 0}))


def test_the_length_of_a_queue_is_that_of_the_root_of_its_interface(monkeypatch):
    statistics = "1800 0300 07000000 a8000000 00000000 00000000 00000000"
    options = f"0a00 0100 706c756700 00 0000 1c00 0700 {statistics}"
    root = bytes.fromhex(f"00000000 05000000 00000180 ffffffff 02000000 {options}")
    within = bytes.fromhex(f"00000000 05000000 00000180 01000180 02000000 {options}")
    for answer, index, length in ((root, 5, 7), (root, 6, 0), (within, 5, 0), (root[:20], 5, 0)):
        monkeypatch.setattr(netlink, "request", lambda *_, answer=answer: [answer])
        assert netlink.queued(index) == length


@pytest.mark.parametrize(
    ("identifier", "data", "state"),
    [
        (0x004, "0004000000000000", "WARNING"),
        (0x004, "0008000000000000", "WARNING"),
        (0x004, "0010000000000000", "PASSIVE"),
        (0x004, "0020000000000000", "PASSIVE"),
        (0x004, "0024000000000000", "PASSIVE"),
        (0x004, "0040000000000000", "ACTIVE"),
        (0x004, "0001000000000000", "UNKNOWN"),
        (0x040, "0000000000000000", "OFF"),
        (0x044, "0020000000000000", "OFF"),
        (0x100, "0000000000000000", "ACTIVE"),
        # byte 1 speaks of the controller only in that class
        (0x088, "0020020000000000", "UNKNOWN"),
        (0x040, "", "OFF"),
        (0x004, "00", "UNKNOWN"),
    ],
)
def test_states_of_error_frames(identifier, data, state):
    assert read_error(identifier, bytes.fromhex(data))[0] is BusState[state]


def test_an_overflow_is_read_where_its_class_is_set():
    assert read_error(0x204, bytes.fromhex("0005000000006003")) == (BusState.WARNING, True)
    assert not read_error(0x204, bytes.fromhex("0006000000006003"))[1]
    assert not read_error(0x008, bytes.fromhex("0001000000000000"))[1]
