"""What `hil homing` writes and refuses: unlike gears, lengths beside the stroke, a run on any of several buses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.can.runtime_folder import RoleLock
from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import loads
from hil.app.homing.command import state_homing
from tests.hil.app.test_homing import configuration, limits, state


def test_of_unlike_gears_a_leg_that_was_measured_may_be_off_by_a_quarter_of_its_own_turn(tmp_path):
    radii = [0.02, 0.018, 0.024, 0.028, 0.016, 0.022]
    text = configuration(tmp_path).text.replace("pulley_radius_m: 0.02\n", f"pulley_radius_m: {radii}\n")
    c = loads(text, "desktop", tmp_path)
    quarters = [0.25 * 0.1 * 2.0 * np.pi * radius for radius in radii]
    state(c)
    assert limits(c) == pytest.approx(quarters)
    file = tmp_path / "bench.yaml"
    parked = file.read_text().replace("state: stated", "state: parked")
    for leg in range(6):
        file.write_text(parked)
        state_homing(c, emulated=True, legs_m={leg: 0.31})
        assert limits(c) == pytest.approx([quarters[k] if k == leg else 5e-4 for k in range(6)])


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("length_m", [0.249, 0.0, -0.3, 0.401, 330.0])
def test_a_length_on_either_side_of_the_stroke_is_refused_and_nothing_is_written(
    tmp_path: Path, leg: int, length_m: float
) -> None:
    c = configuration(tmp_path)
    with pytest.raises(ConfigurationError, match=rf"leg {leg}: {length_m:g} m: outside the stroke"):
        state_homing(c, emulated=True, at_home=True, legs_m={leg: length_m})
    assert not list(tmp_path.iterdir())


def test_the_ends_of_the_stroke_are_within_it(tmp_path: Path) -> None:
    state_homing(configuration(tmp_path), emulated=True, lengths_m=[0.25, 0.4] * 3)
    assert list(tmp_path.iterdir()) == [tmp_path / "bench.yaml"]


@pytest.mark.parametrize("busy", ["left", "right"])
def test_nothing_is_written_while_a_run_has_any_of_the_buses(tmp_path: Path, busy: str) -> None:
    text = configuration(tmp_path).text
    (channel,) = [line for line in text.splitlines() if line.startswith("  channel:")]
    two = "  channels: [{channel: left, legs: [0, 1, 2]}, {channel: right, legs: [3, 4, 5]}]"
    c = loads(text.replace(channel, two), "desktop", tmp_path)
    state(c)
    before = (tmp_path / "bench.yaml").read_text()
    held = RoleLock(c.bus.interface, busy, "controller")
    try:
        with pytest.raises(ConfigurationError, match="is not written while a run may move the legs"):
            state_homing(c, emulated=True, legs_m={2: 0.31})
    finally:
        held.close()
    assert (tmp_path / "bench.yaml").read_text() == before
    state_homing(c, emulated=True, legs_m={2: 0.31})
    assert (tmp_path / "bench.yaml").read_text() != before
