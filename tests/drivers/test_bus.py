"""Buses opened from the configuration: frames, roles, refusals, several channels at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from typing import Any

import pytest

from drivers.can.bus import Bus
from drivers.can.runtime_folder import RoleLock, role_holder, runtime_folder
from drivers.config import BusSettings
from drivers.errors import BusError, RunError
from drivers.frame_array import sent_array
from drivers.protocol import BRS, ERROR, FD, Frame
from tests.drivers.received_frames import got, soon

LOCAL = BusSettings(interface="localcan", channel="t")
GROUP = f"239.74.163.{2 + os.getpid() % 250}"
CHANNEL = f"of-{os.getpid()}"
"""Names of this process only: roles on these interfaces hold for the whole machine."""
CHANNELS = ("a", "b", "c")
pytestmark = pytest.mark.usefixtures("runtime")


def local(channel: str) -> BusSettings:
    return BusSettings(interface="localcan", channel=channel)


def three(**options: dict[str, Any]) -> BusSettings:
    """Three channels of two legs each, with `options` by channel."""
    channels = [
        {"channel": name, "legs": [2 * k, 2 * k + 1], "options": options.get(name, {})}
        for k, name in enumerate(CHANNELS)
    ]
    return BusSettings.model_validate({"channels": channels})


# frames


def test_error_frame_is_not_taken_for_a_data_frame_of_equal_identifier():
    """The class of an error can equal an identifier: 0x80 is a bus error, and SYNC."""
    with Bus.open(LOCAL, "controller") as a, Bus.open(LOCAL, "plant") as b:
        a.send(sent_array([Frame(0x80, b"", ERROR)]))
        time.sleep(0.005)
        deadline = soon(0.02)
        assert got(b.drain(deadline, {0x80})) == []
        assert time.monotonic_ns() >= deadline
        frames = [Frame(0x80, b"\x01"), Frame(0x100, bytes(32), FD | BRS)]
        assert a.send(sent_array(frames)) == 0
        assert [r.frame for r in got(b.drain(soon(), {0x80, 0x100}))] == frames
        assert b.events()[:3] == (1, False, 0)
        assert b.events()[:3] == (0, False, 0)
        assert got(b.drain_now()) == []


def test_udp_multicast_carries_frames_and_stays_on_this_machine():
    settings = BusSettings(interface="udp_multicast", channel=GROUP, options={"port": 43217})
    try:
        a, b = (Bus.open(settings, role) for role in ("controller", "plant"))
    except BusError as error:
        pytest.skip(f"no multicast on this machine: {error}")
    with a, b:
        before = time.monotonic_ns()
        if a.send(sent_array([Frame(0x181, bytes(range(12)), FD | BRS)])):
            pytest.skip("no route for multicast on this machine")
        (received,) = got(b.drain(soon(1), {0x181}))
        assert received.frame == Frame(0x181, bytes(range(12)), FD | BRS)
        assert before - 1_000_000 <= received.t_ns <= time.monotonic_ns()
    far = settings.model_copy(update={"options": {"hop_limit": 1}})
    with pytest.raises(BusError, match="hop_limit"):
        Bus.open(far, "controller")


# refusals


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"interface": "nonsense", "channel": "t"}, ["nonsense", "localcan", "socketcan"]),
        ({"interface": "socketcan", "channel": "nocan7"}, ["nocan7"]),
        ({"interface": "socketcan", "channel": "can0", "options": {"spin_us": 1}}, ["restart_ms"]),
        ({"interface": "slcan", "channel": "/nowhere/tty"}, ["slcan:/nowhere/tty", "bus.channel"]),
        ({"interface": "udp_multicast", "channel": "t-e-x-t"}, ["udp_multicast:t-e-x-t", "bus.channel"]),
        ({"channel": "t", "options": {"spin_us": "x"}}, ["spin_us", "'x'"]),
        ({"channel": "t", "options": {"spin_us": -1}}, ["0 to 10000"]),
        ({"channel": "t", "options": {"colour": 1}}, ["colour", "allowed: spin_us"]),
    ],
)
def test_bus_that_cannot_open_is_refused_and_does_not_keep_the_role_of_controller(settings, words):
    for _ in range(2):
        with pytest.raises(BusError) as caught:
            Bus.open(BusSettings.model_validate(settings), "controller")
        assert all(word in str(caught.value) for word in words)


# roles


@pytest.mark.parametrize("interface", ["localcan", "kvaser"])
def test_second_controller_on_a_bus_is_refused_until_the_first_one_is_killed(interface):
    code = (
        f"from drivers.can.runtime_folder import RoleLock; held = RoleLock({interface!r}, {CHANNEL!r}, "
        "'controller'); print('held', flush=True); input()"
    )
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"held\n"
        if interface == "localcan":
            with pytest.raises(RunError, match=f"controller, process {child.pid}"):
                Bus.open(local(CHANNEL), "controller")
        with pytest.raises(RunError, match=f"controller, process {child.pid}"):
            RoleLock(interface, CHANNEL, "controller")
        child.send_signal(signal.SIGKILL)
    RoleLock(interface, CHANNEL, "controller").close()


@pytest.mark.parametrize("interface", ["socketcan", "kvaser", "udp_multicast"])
def test_plant_role_on_a_hardware_bus_is_exclusive_for_all_users_of_a_machine(
    monkeypatch, tmp_path, interface
):
    held = RoleLock(interface, CHANNEL, "plant")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # as another user or a service has it
    try:
        for _ in range(2):
            assert role_holder(interface, CHANNEL, "plant") == os.getpid()
            with pytest.raises(RunError, match=f"plant, process {os.getpid()}"):
                RoleLock(interface, CHANNEL, "plant")
        for free in (
            (interface, CHANNEL, "controller"),
            (interface, CHANNEL + "b", "plant"),
            ("pcan", CHANNEL, "plant"),
            (interface, f"{CHANNEL}pl", "ant"),
        ):
            assert role_holder(*free) is None
            RoleLock(*free).close()
    finally:
        held.close()
    assert role_holder(interface, CHANNEL, "plant") is None


@pytest.mark.parametrize("role", ["controller", "plant"])
def test_role_of_controller_or_plant_is_taken_and_released_on_each_of_several_buses(role):
    with Bus.open(three(), role):
        for channel in CHANNELS:
            with pytest.raises(RunError, match=f"localcan:{channel} .*{role}.*{os.getpid()}"):
                Bus.open(local(channel), role).close()
        Bus.open(local("d"), role).close()
    for channel in CHANNELS:
        Bus.open(local(channel), role).close()


@pytest.mark.parametrize("bad", CHANNELS)
def test_all_buses_are_closed_if_one_of_several_does_not_open(bad):
    with Bus.open(local(bad), "plant"), pytest.raises(RunError, match=f"localcan:{bad} .*plant"):
        Bus.open(three(), "plant").close()
    with pytest.raises(BusError, match="colour"):
        Bus.open(three(**{bad: {"colour": "red"}}), "plant").close()
    assert list(runtime_folder().glob("*.wire*")) == []
    Bus.open(three(), "plant").close()
