"""Figures that no robot has: refused with the key and what is allowed, before anything waits for them."""

from __future__ import annotations

import re
import time

import pytest
from pydantic import ValidationError

from drivers.errors import ConfigurationError
from hil.app.compose import build_protocol
from hil.app.configuration import yaml_positions
from hil.app.configuration.bus_budget import bus_budget, heartbeats
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.yaml_positions import parse
from hil.config.reference import MOST_POINTS, WaypointReference
from tests.hil.lab.bringup.families import family

VIRTUAL = load("virtual").text
LONG_S = 2.0
"""Far longer than any refusal takes."""


def edited(*changes: tuple[str, str]) -> str:
    text = VIRTUAL
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def reference(section: str) -> str:
    """Return the configuration with another reference."""
    begin, end = VIRTUAL.index("reference:  "), VIRTUAL.index("limits:  ")
    return f"{VIRTUAL[:begin]}reference: {section}\n{VIRTUAL[end:]}"


def multisine(**changes: object) -> str:
    axis = {"axis": "z_m", "band_Hz": [1, 50], "lines": 10, "amplitude": 1e-3} | changes
    period_s = axis.pop("period_s", 5)
    return reference(f"{{type: multisine, period_s: {period_s}, axes: [{axis}]}}")


def waypoints(points: int, last_s: float) -> str:
    times = (last_s * k / (points - 1) for k in range(points))
    listed = ", ".join(f"{{t_s: {t}, position_m: [0, 0, 1]}}" for t in times)
    return reference(f"{{type: waypoints, points: [{listed}]}}")


ABSURD = {
    "plant.model.internal_step_us": [
        edited(("internal_step_us: 100\n", "internal_step_us: 0.05\n")),
        "allowed: at least 0.1 (10000 steps at loop.rate_Hz 1000), given: 0.05",
    ],
    "recording.ring_ticks": [
        edited(("  folder: runs\n", "  folder: runs\n  ring_ticks: 131073\n")),
        "at most 131072",
    ],
    "drives.heartbeat_ms": [edited(("heartbeat_ms: 100\n", "heartbeat_ms: 0.9\n")), "at least 1 "],
    "loop.rate_Hz": [edited(("rate_Hz: 1000\n", "rate_Hz: 1e9\n")), "at most 100000"],
    "loop.cpu": [edited(("  priority: 80 ", "  cpu: -1\n  priority: 80 ")), "at least 0 and at most 1023"],
    "engage.stop_s": [edited(("stop_s: 0.5 ", "stop_s: 61 ")), "at most 60"],
    "limits.stale_fault_ticks": [edited(("fault_ticks: 5\n", f"fault_ticks: {10**30}\n")), "at most 1000"],
    "reference.periods": [edited(("periods: 10\n", f"periods: {10**30}\n")), "at least 1 and at most 1e+06"],
    "reference.points[1].t_s": [waypoints(2, 86_401.0), "at most 86400"],
    "reference.duration_s": [reference("{type: hold, duration_s: 1e20}"), "at most 1e+09"],
    "recording.budget_GB": [
        edited(("  folder: runs\n", "  folder: runs\n  budget_GB: 1e300\n")),
        "at most 1e+09",
    ],
    "reference.axes[0].lines": [multisine(lines=1001), "at most 1000"],
    "reference.axes[0].band_Hz": [multisine(period_s=1000, band_Hz=[1, 400]), "allowed: up to 200 Hz"],
    "reference.components[0].frequency_Hz": [
        reference(
            "{type: sinusoids, duration_s: 5, components: [{axis: z_m, amplitude: 0.001, frequency_Hz: 501}]}"
        ),
        "above half the rate, allowed: up to 500 (loop.rate_Hz 1000), given: 501",
    ],
}
"""Key -> a configuration, and what is said of it."""


@pytest.mark.parametrize("key", ABSURD)
def test_an_absurd_figure_is_refused_at_once_with_its_key_and_what_is_allowed(key):
    text, allowed = ABSURD[key]
    begun = time.process_time()
    with pytest.raises(ConfigurationError) as refused:
        loads(text, "my.yaml")
    assert time.process_time() - begun < LONG_S
    (problem,) = (line for line in refused.value.problems if f": {key}: " in line)
    assert problem.startswith("my.yaml:")
    assert allowed in problem


@pytest.mark.parametrize(
    "text",
    [
        edited(("internal_step_us: 100\n", "internal_step_us: 0.1\n")),
        edited(("  folder: runs\n", "  folder: runs\n  ring_ticks: 131072\n")),
        edited(("periods: 10\n", "periods: 1000000\n")),
        edited(("stop_s: 0.5 ", "stop_s: 60 ")),
        waypoints(2, 86_400.0),
        reference("{type: hold, duration_s: 1e9}"),
        edited(("  folder: runs\n", "  folder: runs\n  budget_GB: 1e9\n")),
    ],
)
def test_the_last_figure_that_is_allowed_is_taken(text):
    assert loads(text, "my.yaml").name == "virtual"


def test_too_many_points_are_refused():
    points = [{"t_s": t, "position_m": [0, 0, 1]} for t in range(10_001)]
    with pytest.raises(ValidationError, match="at most 10000 items"):
        WaypointReference.model_validate({"type": "waypoints", "points": points})
    assert WaypointReference.model_validate({"type": "waypoints", "points": points[1:]}).points


def load_percent(c: Configuration) -> float:
    found = bus_budget(c.bus, c.drives, c.sensors, c.loop.rate_Hz)
    assert found is not None
    return found.load_percent


@pytest.mark.parametrize(
    ("heartbeat_ms", "frames"),
    [(100, 0), (6.1, 0), (6, 1), (5, 1), (3.1, 1)],
)
def test_the_bus_budget_counts_the_heartbeats_that_no_tick_is_without(heartbeat_ms, frames):
    """A status frame is classic, 5 bytes: 44 + 40 + 3 + floor(73 / 4) = 105 bits, 105 us of 1 ms."""
    changed = loads(edited(("heartbeat_ms: 100\n", f"heartbeat_ms: {heartbeat_ms}\n")), "my.yaml")
    assert load_percent(changed) == pytest.approx(56.82 + 10.5 * frames, abs=1e-9)


def test_what_a_drive_says_once_as_it_starts_is_no_heartbeat_of_the_bus_budget():
    protocol = build_protocol(family("cia402_pdo"))
    assert heartbeats(protocol, heartbeat_s=1e-3, rate_Hz=1000.0) == ()


def test_heartbeats_that_do_not_fit_are_refused_with_the_arithmetic():
    with pytest.raises(
        ConfigurationError, match=r"  6 x classic  5 byte: 105 bit = 105\.0 us each, 630\.0 us"
    ):
        loads(edited(("heartbeat_ms: 100\n", "heartbeat_ms: 1\n")), "my.yaml")


def test_a_text_of_more_values_than_any_robot_has_is_refused_where_the_first_too_many_stands(monkeypatch):
    monkeypatch.setattr(yaml_positions, "MOST_VALUES", 5)  # a mapping, its key, a list of two
    assert parse("a:\n - 1\n - 2\n").problems == ()
    (found,) = parse("a:\n - 1\n - 23\n - 3\n").problems
    assert (found.position, found.message) == ((4, 4), "allowed: 5 values in a file")


def test_a_file_may_hold_the_longest_path_of_way_points():
    of_a_point = 1 + 2 * 3 + 2 * 3  # the mapping, three keys with their values, six numbers in two of them
    assert MOST_POINTS * of_a_point < yaml_positions.MOST_VALUES


@pytest.mark.parametrize("turn", [181.0, -1e9])
def test_a_home_that_is_turned_by_more_than_half_a_turn_is_refused_in_degrees(turn):
    old = "rotation_vector_deg: [0, 0, 0]\n  # The"
    with pytest.raises(
        ConfigurationError,
        match=rf"platform.home.rotation_vector_deg: .* {re.escape(format(abs(turn), 'g'))} deg",
    ):
        loads(edited((old, old.replace("[0,", f"[{turn},"))), "a.yaml")


@pytest.mark.parametrize(("count", "last"), [(1, "0 is wrong"), (100, "99 is wrong"), (103, "and 3 more")])
def test_a_message_has_a_hundred_problems_and_says_how_many_more_there_are(count, last):
    error = ConfigurationError(*(f"{k} is wrong" for k in range(count)))
    shown = str(error).splitlines()
    assert (len(shown), shown[-1]) == (min(count, 101), last)
    assert len(error.problems) == count
