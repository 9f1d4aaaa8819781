"""CiA 402 drives carry the shipped robots to their end, and their logs replay exactly."""

from __future__ import annotations

from importlib import resources

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import loads
from hil.app.sim.command import simulate

PDO = {"velocity: difference": "velocity: pdo", "  rate_Hz: 400": "  rate_Hz: 312.5"}
"""Sections of a shipped configuration that its twin with CiA 402 drives has, too."""


def configuration(name, changes=None):
    text = resources.files("configs").joinpath(f"{name}-cia402.yaml").read_text(encoding="utf-8")
    for old, new in (changes or {}).items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, name)


@pytest.mark.parametrize(
    ("name", "changes", "peak_mm"),
    [
        ("virtual", {}, 0.19),
        pytest.param("virtual", PDO, 0.26, marks=pytest.mark.long),
        pytest.param("lab", {}, 2.3, marks=pytest.mark.long),
        pytest.param("lab", PDO, 2.3, marks=pytest.mark.long),
    ],
)
def test_the_robot_tracks_parks_and_replays_exactly(name, changes, peak_mm, tmp_path):
    found = simulate(configuration(name, changes), log=tmp_path / "run.mcap", duration_s=4.0)
    assert found["success"], found
    assert found["final_mode"] == "PARKED"
    assert found["rejected_frames"] == 0
    assert found["tracking"]["peak_leg_error_mm"] < peak_mm
    assert (found["replay"]["exact"], found["replay"]["wire_different_ticks"]) == (True, 0)


def test_a_rate_above_the_bus_is_refused_with_the_arithmetic():
    with pytest.raises(ConfigurationError) as refused:
        configuration("virtual", {"velocity: difference": "velocity: pdo"})
    text = str(refused.value)
    assert "6 x classic  8 byte: 135 bit = 135.0 us each, 810.0 us" in text
    assert "12 x classic  4 byte: 95 bit = 95.0 us each, 1140.0 us" in text
    assert "total 2005.0 us of a 2500.0 us period = 80.2 % at 400 Hz (allowed 70 %)" in text
    assert "up to 349 Hz" in text
