"""What the controller's end makes of frames by address is what the protocol's methods make of them."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from drivers.compiled.pointed import data_at
from drivers.ends import drives_end, hearing
from drivers.frame_array import FRAME, received_array
from drivers.protocol import BUS, EXTENDED, FD, Frame, Received
from drivers.several_buses import SeveralBuses
from drivers.signals import LEGS
from tests.drivers.cia402_drives import drives
from tests.drivers.test_no_reading import FAMILIES

PROTOCOLS: dict[str, Any] = {**FAMILIES, "cia402": drives(), "cia402 difference": drives(velocity=False)}
BUSES = ((0, 4), (1, 5), (2, 3))


def called(address: int, *arguments: int) -> int:
    """Call a C function of integers."""
    return int(ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * len(arguments))(address)(*arguments))


def candidates(protocol: Any) -> list[Frame]:
    """Return frames of both ends, whole, cut, of strange flags and of other identifiers."""
    frames = [*protocol.cyclic_frames(), *protocol.emergency_stop()]
    frames += [frame for row in getattr(protocol, "identity_requests", tuple)() for frame in row]
    found = []
    for identifier, data, flags in frames:
        found += [Frame(identifier, data, flags), Frame(identifier ^ 0x40, data, flags)]
        found += [Frame(identifier, data[:-1], flags), Frame(identifier, data, flags ^ FD)]
        found += [Frame(identifier, data, flags ^ EXTENDED), Frame(identifier ^ 0x100, data, flags)]
    return found


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("name", PROTOCOLS)
def test_frames_by_address_are_fresh_and_addressed_as_the_methods_have_it(name, several):
    family = PROTOCOLS[name]
    protocol: Any = SeveralBuses(family, BUSES) if several else family
    by_address = hearing(protocol)
    assert set(by_address.wanted) == protocol.feedback_ids
    heard = 0
    for identifier, data, flags in candidates(family):
        for bus in range(4 if several else 1):
            frame = Frame(identifier, data, flags + BUS * bus)
            for t_ns in (99, 100):
                received = Received(t_ns, frame)
                array = np.array(received_array([received]))
                assert array.dtype == FRAME
                place = called(by_address.fresh, by_address.context, data_at(array), 7, 100)
                heard += place > 0
                fresh = protocol.fresh(received, 7, 100)
                assert (place > 0) == fresh, frame
                assert not fresh or by_address.wanted[place - 1] == protocol.awaited(frame)
            legs = called(by_address.addressed, by_address.context, data_at(array))
            assert tuple(leg for leg in range(LEGS) if legs >> leg & 1) == protocol.addressed(frame), frame
    assert heard >= LEGS


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("name", PROTOCOLS)
def test_the_memory_of_drives_by_address_is_that_of_the_methods(name, several):
    family = PROTOCOLS[name]
    protocol: Any = SeveralBuses(family, BUSES) if several else family
    end = drives_end(protocol)
    assert end.parse
    assert end.memory == protocol.power_up()
