"""CiA 402 drives carry the shipped robots to their end, and their logs replay exactly."""

from __future__ import annotations

from importlib import resources

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import loads
from hil.app.sim.command import simulate
from tests.broad import broad

OPTIONS = """  protocol: cia402
  options: {{rated_torque_Nm: {rated}, velocity: {velocity}}}
  transmission: {{lead_m: 0.02, counts_per_turn: 131072, offset_m: 0.7}}"""


def configuration(name, rate_Hz, velocity, rated, **more):
    text = resources.files("configs").joinpath(f"{name}.yaml").read_text(encoding="utf-8")
    changes = {
        "  layout: fd": "  layout: classic",
        "  protocol: legs": OPTIONS.format(rated=rated, velocity=velocity),
        "  rate_Hz: 1000": f"  rate_Hz: {rate_Hz}",
        "  watchdog_ms: 10": "  watchdog_ms: 20",
    }
    for old, new in (changes | more).items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, name)


@pytest.mark.parametrize(
    ("name", "rate_Hz", "velocity", "rated", "peak_mm"),
    broad(
        [
            ("virtual", 400, "difference", 60, 0.25),
            ("lab", 312.5, "pdo", 9.5, 2.5),
            ("virtual", 312.5, "pdo", 60, 0.3),
            ("lab", 400, "difference", 9.5, 2.5),
        ],
        quick=2,
    ),
)
def test_the_robot_tracks_and_parks_and_the_log_replays_exactly(
    name, rate_Hz, velocity, rated, peak_mm, tmp_path
):
    found = simulate(configuration(name, rate_Hz, velocity, rated), log=tmp_path / "run.mcap", duration_s=4.0)
    assert found["success"], found
    assert found["final_mode"] == "PARKED"
    assert found["rejected_frames"] == 0
    assert found["tracking"]["peak_leg_error_mm"] < peak_mm
    assert (found["replay"]["exact"], found["replay"]["wire_different_ticks"]) == (True, 0)


def test_a_rate_that_the_bus_does_not_carry_is_refused_with_the_arithmetic():
    configuration("virtual", 400, "difference", 60)
    with pytest.raises(ConfigurationError) as refused:
        configuration("virtual", 400, "pdo", 60)
    text = str(refused.value)
    assert "6 x classic  8 byte: 135 bit = 135.0 us each, 810.0 us" in text
    assert "12 x classic  4 byte: 95 bit = 95.0 us each, 1140.0 us" in text
    assert "total 2005.0 us of a 2500.0 us period = 80.2 % at 400 Hz (allowed 70 %)" in text
    assert "up to 349 Hz" in text


def test_a_reaction_that_such_drives_do_not_have_is_refused():
    changes = {"  silence: brake ": "  silence: hold  "}
    with pytest.raises(ConfigurationError, match=r"allowed with drives\.protocol cia402.*brake, damp"):
        configuration("virtual", 400, "difference", 60, **changes)
