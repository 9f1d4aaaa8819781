"""Bus: opening, roles, refusals, events, and the interfaces behind it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time

import can
import pytest

from drivers.can.bus import Bus
from drivers.can.python_can import PythonCan
from drivers.can.socketcan import pack, unpack
from drivers.config import BusSettings
from drivers.errors import BusError, RunError
from drivers.frame_array import sent_array
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame
from drivers.signals import BusState
from tests.drivers.frames_heard import got

LOCAL = BusSettings(interface="localcan", channel="t")
GROUP = f"239.74.163.{2 + os.getpid() % 250}"
"""A role on it is one of the whole machine."""
pytestmark = pytest.mark.usefixtures("runtime")


def soon(seconds=2.0):
    return time.monotonic_ns() + int(seconds * 1e9)


def test_frames_and_error_frames_are_told_apart():
    with Bus.open(LOCAL, "controller") as a, Bus.open(LOCAL, "plant") as b:
        assert a.send(sent_array([Frame(0x80, b"\x01"), Frame(0x100, bytes(32), FD | BRS)])) == 0
        assert a.send(sent_array([Frame(0, b"", ERROR)])) == 0
        received = got(b.drain(soon(), {0x80, 0x100}))
        assert [r.frame.id for r in received] == [0x80, 0x100]
        received += got(b.wait(soon(0.05)))
        assert not any(r.frame.flags & ERROR for r in received)
        assert b.events()[:3] == (1, False, 0)
        assert b.events()[:3] == (0, False, 0)
        assert got(b.drain_now()) == []


def test_an_error_frame_is_none_of_the_frames_that_are_waited_for():
    """Its classes can be the number of an identifier: 0x80 is a bus error, and SYNC."""
    with Bus.open(LOCAL, "controller") as a, Bus.open(LOCAL, "plant") as b:
        a.send(sent_array([Frame(0x80, b"", ERROR)]))
        time.sleep(0.005)
        deadline = soon(0.02)
        assert got(b.drain(deadline, {0x80})) == []
        assert time.monotonic_ns() >= deadline
        a.send(sent_array([Frame(0x80, b"\x01")]))
        assert [r.frame.id for r in got(b.drain(soon(), {0x80}))] == [0x80]


def test_wait_returns_as_soon_as_a_frame_has_come():
    with Bus.open(LOCAL, "controller") as a, Bus.open(LOCAL, "plant") as b:
        a.send(sent_array([Frame(1, bytes(8))]))
        before = time.monotonic()
        assert [r.frame.id for r in got(b.wait(soon(5)))] == [1]
        assert time.monotonic() - before < 1
        deadline = soon(0.01)
        assert got(b.wait(deadline)) == []
        assert time.monotonic_ns() >= deadline


def test_a_busy_bus_refuses_frames_and_a_lasting_refusal_is_a_dead_bus():
    # 200 bit/s: a frame of 8 bytes takes 0.675 s
    slow = BusSettings(interface="localcan", channel="t", layout="classic", bitrate_bit_s=200)
    frames = [Frame(i, bytes(8)) for i in range(70)]
    with Bus.open(slow, "controller") as bus:
        assert bus.send(sent_array(frames[:1])) == 0
        # one is on the wire, 64 wait
        assert bus.send(sent_array(frames)) == 6
        assert bus.send(sent_array(frames[:2])) == 2
        assert not bus.events().off
        time.sleep(0.06)
        assert bus.send(sent_array(frames[:2])) == 2
        assert bus.events().off
        bus.flush_tx()
        assert bus.send(sent_array(frames[:2])) == 0
        assert not bus.events().off


def test_second_controller_is_refused_with_the_others_process_number():
    code = (
        "import time; from drivers.can.bus import Bus; from drivers.config import BusSettings\n"
        "bus = Bus.open(BusSettings(interface='localcan', channel='t'), 'controller')\n"
        "print('ready', flush=True); time.sleep(60)"
    )
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    try:
        assert child.stdout.readline() == "ready\n"
        with pytest.raises(RunError, match=rf"localcan:t already has a controller, process {child.pid}"):
            Bus.open(LOCAL, "controller")
        Bus.open(LOCAL, "plant").close()
        Bus.open(BusSettings(interface="localcan", channel="u"), "controller").close()
        child.send_signal(signal.SIGKILL)
        child.wait(10)
        Bus.open(LOCAL, "controller").close()
    finally:
        child.kill()
        child.wait(10)
        child.stdout.close()


def test_role_is_given_back_by_close_and_by_a_failed_open():
    wrong = BusSettings(interface="localcan", channel="t", options={"colour": "red"})
    with pytest.raises(BusError, match="colour"):
        Bus.open(wrong, "controller")
    with Bus.open(LOCAL, "controller"), pytest.raises(RunError, match=str(os.getpid())):
        Bus.open(LOCAL, "controller")
    Bus.open(LOCAL, "controller").close()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"interface": "nonsense", "channel": "t"}, ["nonsense", "localcan", "socketcan"]),
        ({"interface": "socketcan", "channel": "nocan7"}, ["nocan7", "localcan"]),
        ({"interface": "slcan", "channel": "/nowhere/tty"}, ["slcan:/nowhere/tty", "bus.channel"]),
        (
            {"interface": "udp_multicast", "channel": GROUP, "options": {"hop_limit": 1}},
            ["hop_limit", "network"],
        ),
        ({"interface": "udp_multicast", "channel": "t-e-x-t"}, ["udp_multicast:t-e-x-t", "bus.channel"]),
        ({"interface": "localcan", "channel": "t", "options": {"spin_us": "x"}}, ["spin_us", "'x'"]),
    ],
)
def test_what_cannot_be_opened_is_refused_in_clear_words(settings, words):
    with pytest.raises(BusError) as caught:
        Bus.open(BusSettings.model_validate(settings), "controller")
    for word in words:
        assert word in str(caught.value)


def test_timing_that_disagrees_is_refused():
    other = BusSettings(interface="localcan", channel="t", bitrate_bit_s=500_000, layout="classic")
    with Bus.open(LOCAL, "controller"), pytest.raises(BusError, match="classic CAN 500000"):
        Bus.open(other, "plant")


def open_multicast(role):
    settings = BusSettings(interface="udp_multicast", channel=GROUP, options={"port": 43217})
    try:
        return Bus.open(settings, role)
    except BusError as error:
        pytest.skip(f"no multicast on this machine: {error}")


def test_udp_multicast_stays_on_this_machine_and_carries_frames():
    with open_multicast("controller") as a, open_multicast("plant") as b:
        assert isinstance(a._links[0], PythonCan)
        sock = a._links[0]._bus._multicast._socket  # type: ignore[attr-defined]
        assert sock.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
        before = time.monotonic_ns()
        if a.send(sent_array([Frame(0x181, bytes(range(12)), FD | BRS)])):
            pytest.skip("no route for multicast on this machine")
        (received,) = got(b.drain(soon(1), {0x181}))
        assert received.frame == Frame(0x181, bytes(range(12)), FD | BRS)
        assert before - 1_000_000 <= received.t_ns <= time.monotonic_ns()
        deadline = soon(0.01)
        assert got(b.drain(deadline, {0x182})) == []
        assert time.monotonic_ns() - deadline < 200_000_000


def test_any_python_can_interface_works_through_messages():
    # python-can's virtual bus in one process, past the refusal that Bus.open makes
    a, b = (Bus([PythonCan(can.Bus("t", "virtual", ignore_config=True))]) for _ in range(2))
    with a, b:
        frames = [Frame(0x7FF, b"12345678"), Frame(0x1FFFFFFF, b"", EXTENDED), Frame(1, bytes(64), FD | BRS)]
        assert a.send(sent_array(frames)) == 0
        assert [r.frame for r in got(b.drain(soon(1), {0x7FF, 1}))] == frames
        a.send(sent_array([Frame(5, b"x")]))
        assert [r.frame.id for r in got(b.wait(soon(1)))] == [5]
        assert b.events()[:3] == (0, False, 0)


# struct can_frame and canfd_frame of linux/can.h, little endian, written out by hand
@pytest.mark.skipif(sys.byteorder != "little", reason="byte vectors are little endian")
@pytest.mark.parametrize(
    ("frame", "raw"),
    [
        (Frame(0x123, b"\x01\x02"), "23010000 02000000 0102000000000000"),
        (Frame(0x1ABCDEF0, b"", EXTENDED), "f0debc9a 00000000 0000000000000000"),
        (Frame(0x12, b"", REMOTE), "12000040 00000000 0000000000000000"),
        (Frame(0x181, b"\xff" * 12, FD | BRS), "81010000 0c010000" + "ff" * 12 + "00" * 52),
        (Frame(0x181, b"\xff" * 64, FD | ESI), "81010000 40020000" + "ff" * 64),
    ],
)
def test_socketcan_frames_are_those_of_the_kernel(frame, raw):
    assert pack(*frame) == bytes.fromhex(raw)
    assert unpack(bytes.fromhex(raw)) == frame


def test_socketcan_error_frame_keeps_its_class():
    # CAN_ERR_FLAG | CAN_ERR_BUSOFF
    assert unpack(bytes.fromhex("40000020 08000000 0000000000000000")) == Frame(0x40, bytes(8), ERROR)


def test_socketcan_refuses_too_long_data():
    with pytest.raises(BusError, match="9 bytes"):
        pack(*Frame(1, bytes(9)))


@pytest.mark.parametrize("interface", ["localcan", "udp_multicast"])
def test_of_a_controller_that_nobody_sees_no_state_is_told_and_nothing_was_read(interface):
    channel = "t" if interface == "localcan" else GROUP
    with Bus.open(BusSettings(interface=interface, channel=channel), "viewer") as bus:
        assert [bus.events().state for _ in range(2)] == [BusState.UNKNOWN] * 2
        assert (bus.facts, bus.knows_ends, bus.virtual) == (
            "",
            interface == "localcan",
            interface != "localcan",
        )
