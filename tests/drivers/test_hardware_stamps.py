"""Hardware stamps of received frames, in control messages of the kernel made by the tests."""

from __future__ import annotations

import socket
import struct
from typing import Any

import numpy as np
import pytest

from drivers.can import hardware_stamps, socketcan
from drivers.can.bus import Bus
from drivers.can.hardware_stamps import ControllerClock, stamped_by, stamps_of
from drivers.config import BusSettings
from drivers.errors import BusError
from tests.drivers.received_frames import got
from tests.drivers.test_socketcan import RESTARTED, SETTINGS, clock, kernel  # noqa: F401

MS, SECOND = 1_000_000, 1_000_000_000
BOOTED_NS, NOW_NS = 1_000 * SECOND, 1_700_000_000 * SECOND
"""The controller's clock, which starts anywhere, and the kernel's."""


def message(arrives_ns: int, stamp_ns: int) -> list[tuple[int, int, bytes]]:
    """SCM_TIMESTAMPING with struct scm_timestamping: software, unused, hardware; and SO_RXQ_OVFL."""
    three = *divmod(arrives_ns, SECOND), 0, 0, *divmod(stamp_ns, SECOND)
    return [(1, 40, bytes(4)), (1, 37, struct.pack("=6q", *three))]


def errors_us(own: ControllerClock, took_us: Any, *, drift: float = 0.0) -> Any:
    """Errors of the times of frames, sent every ms, that reach the kernel after `took_us`."""
    found = []
    for k, late_us in enumerate(took_us):
        at_ns = k * MS
        given = message(NOW_NS + at_ns + round(1e3 * late_us), BOOTED_NS + round(at_ns * (1 + drift)))
        found.append(1e-3 * (own.taken_ns(*stamps_of(given)) - NOW_NS - at_ns))
    return np.array(found)


@pytest.mark.parametrize("drift", [-5e-5, 0.0, 5e-5])
def test_hardware_stamps_take_the_jitter_of_the_adapter_off_the_times_of_frames(drift):
    took_us = 120 + np.random.default_rng(2).uniform(0, 1800, 3000)  # PCAN-USB: +-900 us, python-can 1881
    found = errors_us(ControllerClock(), took_us, drift=drift)
    assert np.ptp(found[500:]) < 60
    assert abs(found[500:].mean() - 120) < 60, "what the fastest frame takes is not seen"
    assert (found <= took_us + 1e-3).all(), "never after its arrival"


def test_frame_without_stamp_has_its_arrival_and_a_clock_set_back_or_started_again_is_compared_anew():
    own = ControllerClock()
    assert errors_us(own, [100, 2000]) == pytest.approx([100, 100], abs=0.2)
    assert own.taken_ns(*stamps_of(message(NOW_NS + 3, 0))) == NOW_NS + 3
    assert own.taken_ns(*stamps_of(message(NOW_NS, BOOTED_NS - 20 * MS))) == NOW_NS
    errors_us(own, [100] * 3)
    own.forget()
    assert errors_us(own, [2000]) == pytest.approx([2000])


def test_time_of_a_frame_is_its_hardware_stamp_until_the_can_controller_restarts(kernel, clock, monkeypatch):  # noqa: F811
    monkeypatch.setattr(hardware_stamps, "stamped_by", lambda _: "hardware")
    clock.time_ns = lambda: NOW_NS
    can = socketcan.SocketCan(SETTINGS)
    (sock,) = kernel.sockets
    assert sock.options[socket.SOL_SOCKET, 37] == 0x5C, "SO_TIMESTAMPING"
    assert "time stamps of hardware" in can.facts
    times = []
    for word, late_ns, stamp_ns in ((0x80, 0, 5), (0x80, MS, 5), (RESTARTED, MS, 0), (0x80, MS, 5)):
        raw = struct.pack("=IB3x8s", word, 8, bytes(8))
        sock.answers.append((raw, message(NOW_NS + late_ns, stamp_ns), 0, None))
        times += [each.t_ns - clock.ns for each in got(can.receive())]
    assert times == [0, 0, MS, MS]


def test_interface_without_hardware_stamps_has_those_of_the_kernel_and_the_option_is_a_boolean():
    bus = BusSettings(interface="socketcan", channel="none0", layout="classic")
    wanted, wrong = (bus.model_copy(update={"options": {"hardware_stamps": v}}) for v in (True, "yes"))
    assert stamped_by(bus) == "the kernel"
    assert stamped_by(wanted).startswith("the kernel: the driver gives no")
    with pytest.raises(BusError, match="hardware_stamps: true or false"):
        Bus.open(wrong, "controller")
