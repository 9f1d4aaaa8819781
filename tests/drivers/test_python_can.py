"""The interfaces of python-can: with which bit rates a bus is opened, and when one counts as off."""

from __future__ import annotations

from typing import Any

import can
import pytest

from drivers.can.python_can import PythonCan, open_python_can
from drivers.config import BusSettings
from drivers.protocol import Frame


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
    return {key: value for key, value in adapter.options.items() if key != "ignore_config"}


def test_a_bus_with_a_data_phase_is_opened_with_the_bit_rate_of_each_phase(monkeypatch):
    assert opened(monkeypatch, layout="fd") == {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000}


def test_a_classic_bus_is_opened_without_a_data_phase(monkeypatch):
    assert opened(monkeypatch, layout="classic") == {"bitrate": 500_000}


def test_options_of_the_bus_take_the_place_of_its_bit_rates(monkeypatch):
    own = {"bitrate": 250_000, "data_bitrate": 4_000_000, "fd": False, "single_handle": True}
    assert opened(monkeypatch, layout="fd", options=own) == own


def test_a_bus_that_failed_is_off_until_it_takes_frames_again_each_time():
    adapter: Any = Adapter()
    bus = PythonCan(adapter)
    frames = [Frame(1, b"x"), Frame(2, b"y")]
    for _ in range(2):
        adapter.receives, adapter.sends = False, False
        assert bus.receive() == []
        assert bus.off
        assert bus.send(frames) == 0
        assert bus.off, "it has taken nothing yet"
        adapter.receives, adapter.sends = True, True
        assert bus.receive() == []
        assert bus.send(frames) == 2
        assert not bus.off
