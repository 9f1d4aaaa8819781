"""The interfaces of python-can: with which bit rates a bus is opened, and when one counts as off, and how its frames are stamped."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import can
import pytest

from drivers.can import python_can
from drivers.can.python_can import PythonCan, open_python_can
from drivers.config import BusSettings
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from tests.drivers.frames_heard import got


class Adapter:
    """A stand-in for a bus of python-can. Mutable state: how it was opened, whether its calls fail."""

    def __init__(self, *place: str, **options: Any) -> None:
        self.place, self.options = place, options
        self.receives = self.sends = True

    def fileno(self) -> int:
        raise NotImplementedError

    def recv(self, _timeout_s: float) -> None:
        if not self.receives:
            raise can.CanOperationError("gone")

    def send(self, _message: can.Message, timeout: float) -> None:
        if not self.sends:
            raise can.CanOperationError("full")
        assert timeout == 0


def opened(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> dict[str, Any]:
    """Return the options with which a bus of the interface kvaser is opened."""
    monkeypatch.setattr(can, "Bus", Adapter)
    settings = {
        "interface": "kvaser",
        "channel": "3",
        "bitrate_bit_s": 500_000,
        "data_bitrate_bit_s": 2_000_000,
    }
    adapter: Any = open_python_can(BusSettings.model_validate(settings | changes))._bus
    assert adapter.place == ("3", "kvaser")
    assert adapter.options.pop("ignore_config") is True, "what python-can is told in other places"
    options: dict[str, Any] = adapter.options
    return options


def test_a_bus_with_a_data_phase_is_opened_with_the_bit_rate_of_each_phase(monkeypatch):
    assert opened(monkeypatch, layout="fd") == {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000}


def test_a_classic_bus_is_opened_without_a_data_phase(monkeypatch):
    assert opened(monkeypatch, layout="classic") == {"bitrate": 500_000}


def test_options_of_the_bus_take_the_place_of_its_bit_rates(monkeypatch):
    own = {"bitrate": 250_000, "data_bitrate": 4_000_000, "fd": False, "single_handle": True}
    assert opened(monkeypatch, layout="fd", options=own) == own


@pytest.mark.parametrize("interface", ["kvaser", "udp_multicast"])
def test_what_a_file_or_the_environment_of_python_can_says_does_not_count(monkeypatch, interface):
    """There others may have written a bit rate for their own work, or a hop limit."""
    found: list[Any] = []

    def bus(*place: str, **options: Any) -> Adapter:
        found.append(options)
        return Adapter(*place)

    monkeypatch.setattr(can, "Bus", bus)
    open_python_can(BusSettings(interface=interface, channel="3"))
    (options,) = found
    assert options["ignore_config"] is True
    assert options.get("hop_limit") == (0 if interface == "udp_multicast" else None)


def test_a_bus_that_failed_is_off_until_it_takes_frames_again_each_time():
    adapter: Any = Adapter()
    bus = PythonCan(adapter)
    frames = [Frame(1, b"x"), Frame(2, b"y")]
    for _ in range(2):
        adapter.receives, adapter.sends = False, False
        assert got(bus.receive()) == []
        assert bus.off
        assert bus.send(sent_array(frames)) == 0
        assert bus.off, "it has taken nothing yet"
        adapter.receives, adapter.sends = True, True
        assert got(bus.receive()) == []
        assert bus.send(sent_array(frames)) == 2
        assert not bus.off


REAL_NS, NOW_NS = 1_700_000_000_000_000_000, 5_000_000_000


class Stamping(Adapter):
    """A bus on which one frame has come, stamped `age_s` before it is taken."""

    def __init__(self, age_s: float) -> None:
        super().__init__()
        self.coming = [can.Message(timestamp=1e-9 * REAL_NS - age_s, arbitration_id=1)]

    def recv(self, _timeout_s: float) -> Any:
        return self.coming.pop() if self.coming else None


def stamp_ns(monkeypatch: pytest.MonkeyPatch, interface: str, age_s: float) -> int:
    """Return how long before it was taken a frame has come, by its time."""
    monkeypatch.setattr(
        python_can, "time", SimpleNamespace(time_ns=lambda: REAL_NS, monotonic_ns=lambda: NOW_NS)
    )
    adapter: Any = Stamping(age_s)
    monkeypatch.setattr(can, "Bus", lambda *_, **__: adapter)
    settings = BusSettings(interface=interface, channel="0", layout="classic")
    (received,) = got(open_python_can(settings).receive())
    return NOW_NS - received.t_ns


@pytest.mark.parametrize("age_s", [0.0, 3e-4, 0.9, 1.1, -3e-4])
@pytest.mark.parametrize("interface", ["kvaser", "pcan", "slcan", "udp_multicast"])
def test_a_frame_has_the_time_at_which_it_was_taken_whatever_its_own_stamp_says(
    monkeypatch, interface, age_s
):
    assert stamp_ns(monkeypatch, interface, age_s) == 0


def test_no_answer_on_a_bus_without_a_wire_takes_its_time():
    adapter: Any = Adapter()
    assert PythonCan(adapter, "udp_multicast").virtual
    assert not PythonCan(adapter, "kvaser").virtual
