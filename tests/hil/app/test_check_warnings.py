"""Warnings of `hil check`: each code just below and just above its threshold."""

from __future__ import annotations

import copy
import re
from typing import Any

import pytest

from hil.app.check.command import inspect
from hil.app.check.subject import looked_at
from hil.app.check.warnings import HARDWARE, WARNINGS, warnings
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from tests.broad import broad
from tests.hil.app.test_configs import NAMES

pytestmark = pytest.mark.usefixtures("unproven")
Changes = dict[str, Any]


def warned(name: str, changes: Changes) -> list[str]:
    """Codes of the warnings about a shipped configuration with changes."""
    c = load(name)
    return inspect(loads(with_changes(c.text, changes), "my.yaml", c.folder)).codes


def value(section: str, key: str, harmless: object, dangerous: object) -> tuple[Changes, Changes]:
    return {section: {key: harmless}}, {section: {key: dangerous}}


def bench(part: str, key: str, harmless: object, dangerous: object) -> tuple[Changes, Changes]:
    return {"plant": {part: {key: harmless}}}, {"plant": {part: {key: dangerous}}}


def noise(harmless_m: float, dangerous_m: float, **limits: float) -> tuple[Changes, Changes]:
    fine, bad = ({"monitor": {"length_noise_m": m, "friction_N": 0}} for m in (harmless_m, dangerous_m))
    return fine | {"limits": limits}, bad | {"limits": limits}


SLIDING = {
    "law": "sliding_mode", "lambda_rad_s": 92, "reaching_m_s2": 1, "model": {"variant": "full"},
    "uncertainty": {"disturbance_m_s2": 13, "model_error": 0.1, "acceleration_m_s2": 12},
}  # fmt: skip
FROZEN = {"variant": "constant", "frozen_at": {"position_m": [0, 0, 1]}}
CUBEMARS = {"drives": {"options": {"variant": "cubemars", "model": "AK80-9"}}}
OBSERVER, LIGHT = {"source": "observer"}, {"inertia_scale": 0.9}
OBSERVED = {"estimation": {"wrench": OBSERVER}}
PAGE = {"watch": {"operate": True}}


def live(acceleration_m_s2: float, deceleration_m_s2: float, speed_m_s: float) -> Changes:
    return {
        "reference": {
            "type": "live",
            "limits": {
                "velocity_m_s": 0.2, "velocity_deg_s": 10, "acceleration_m_s2": acceleration_m_s2,
                "acceleration_deg_s2": 50, "jerk_m_s3": 200, "jerk_deg_s3": 500,
            },
        },
        "limits": {"deceleration_m_s2": deceleration_m_s2, "speed_m_s": speed_m_s},
    }  # fmt: skip


def mass(brake_force_N: float) -> Changes:
    return {"plant": {"model": {"brake_force_N": brake_force_N}}}


# The book's path needs 16022 N and 1.129 m/s; vcan50 needs 1.875 x 0.1 m/s to reach its start; virtual's legs
# carry 3619 N at rest; lab has a stroke of 0.45 m and a following error of 10 mm.
JOINTS: Any = load("desktop").platform.platform_joints_m
SWAPPED = {"platform": {"platform_joints_m": [JOINTS[k] for k in (1, 0, 3, 2, 5, 4)]}}
EXAMPLES: list[tuple[str, str, tuple[Changes, Changes]]] = [
    ("engage.brake_close_s", "virtual", value("engage", "brake_close_s", 0.125, 0.135)),
    ("limits", "vcan50", value("limits", "speed_m_s", 0.749, 0.751)),
    ("limits.force_N on the reference", "virtual", value("limits", "force_N", 18000, 17000)),
    ("limits.deceleration_m_s2", "virtual", value("limits", "deceleration_m_s2", 185, 195)),
    ("reactions.silence", "virtual", value("reactions", "silence", "hold", "zero")),
    ("reactions sto", "virtual", value("reactions", "following", "ss1", "sto")),
    ("engage.force_ramp_s", "virtual", value("engage", "force_ramp_s", 0.01, 0)),
    ("plant.model.brake_force_N", "virtual", (mass(3620), mass(3618))),
    ("plant.drives brake times", "bench", bench("drives", "brake_open_ms", 0.1, 0)),
    ("monitor.length_noise_m and jumps", "lab", noise(0.022, 0.023, following_error_m=0.5)),
    ("monitor.length_noise_m and standstill", "lab", noise(0.9e-3, 1.1e-3)),
    (
        "limits.following_error_m and steps of the force",
        "lab",
        value("controller", "wn_rad_s", 1, 0.04),
    ),
    ("drives.force_limit_N", "socketcan", value("drives", "force_limit_N", 60000, None)),
    ("controller.model.variant", "virtual", ({}, {"controller": {"model": FROZEN}})),
    ("controller.model.variant", "virtual", ({}, {"controller": {"model": {"variant": "printed"}}})),
    (
        "estimation.wrench.model",
        "virtual",
        (OBSERVED, {"estimation": {"wrench": {"model": LIGHT, **OBSERVER}}}),
    ),
    ("controller phase margin", "virtual", value("controller", "wn_rad_s", 20, 200)),
    (
        "controller.boundary_layer_m_s",
        "virtual",
        ({"controller": SLIDING}, {"controller": SLIDING | {"boundary_layer_m_s": 0}}),
    ),
    ("controller.uncertainty.acceleration_m_s2", "virtual", ({}, {"controller": SLIDING})),
    ("loop.feedback_window_us", "virtual", value("loop", "feedback_window_us", 500, 400)),
    ("bus.interface", "virtual", value("bus", "interface", "pcan", "sockercan")),
    ("drives.homing", "desktop", ({"drives": {"homing": {"file": "a.yaml", "limit_m": 0.001}}}, {})),
    ("platform joints", "desktop", ({}, SWAPPED)),
    ("drives.protocol", "virtual", ({}, {})),
    ("limits while operated", "virtual", value("operator", "setup_speed_m_s", 0.05, 2.5)),
    ("limits while operated", "virtual", (live(1, 15, 2), live(12, 15, 2))),
    ("limits while operated", "virtual", (live(1, 15, 2), live(1, 15, 0.3))),
    (
        "operator.deadman_s of the page",
        "virtual",
        (PAGE | {"operator": {"deadman_s": 0.15}}, PAGE | {"operator": {"deadman_s": 0.14}}),
    ),
    ("operator.deadman_s of hil ctl", "virtual", value("operator", "deadman_s", 0.06, 0.059)),
    ("operator.deadman_s in ticks", "virtual", value("operator", "deadman_s", 0.003, 0.0029)),
]
ELSEWHERE = {
    "drives.transmission", "controller.controller_file", "controller.controller_file of another robot",
    "controller unstable", "feedforward rate", "feedforward.fade_s", "feedforward changes", "feedforward.limit_N",
    "plant.model.brake", "plant.model.allow_execution_tool", "plant.model legs", "plant.model coupling",
    "plant.model.step_us", "plant.model reports", "loop.without_realtime", "reference.path", "schema",
    "bus adapter",
}  # fmt: skip
"""Codes with examples that need a file, a proof or properties of this machine."""


@pytest.mark.parametrize(("code", "name", "changes"), EXAMPLES, ids=[code for code, *_ in EXAMPLES])
def test_check_warns_about_a_dangerous_setting_only_beyond_its_threshold(code, name, changes):
    harmless, dangerous = changes
    if code == "drives.protocol":
        assert code not in warned("virtual", {})
        assert warned("desktop", CUBEMARS).count(code) == 2
        return
    assert code not in warned(name, harmless)
    assert code in warned(name, dangerous)


@pytest.mark.parametrize(("noise_m", "codes"), [(0.0, 0), (2e-7, 1)])
def test_noise_of_a_recorded_path_is_reported(noise_m, codes, tmp_path):
    """A slow path at 1 kHz: rows that alternate by 0.2 um have second differences of 0.4 m/s^2."""
    rows = [f"{1e-3 * k},0,0,{1 + 1e-6 * k + noise_m * (k % 2)},0,0,0" for k in range(200)]
    (tmp_path / "path.csv").write_text("\n".join(["t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", *rows]))
    reference = {"type": "sampled", "path": str(tmp_path / "path.csv")}
    assert warned("virtual", {"reference": reference}).count("reference.path") == codes


def test_every_warning_code_has_an_example():
    assert {*HARDWARE, *WARNINGS} == {code for code, *_ in EXAMPLES} | ELSEWHERE


@pytest.mark.parametrize("name", broad(NAMES, quick=3))
def test_no_shipped_configuration_has_a_dangerous_limit(name):
    allowed = {"drives.protocol", "drives.homing", "loop.without_realtime"}
    assert set(inspect(load(name)).codes) <= allowed


def test_bus_layout_ideal_causes_no_warning_about_hardware():
    assert "reactions.silence" not in warned("ideal", {"reactions": {"silence": "zero"}})


# By hand. Forces: the path needs 16022 N, 5.7 kN within 250 ms, 1.129 m/s, a condition of 4.83. At rest the
# error dynamics leave 8 m/s^2 / (20 rad/s)^2 = 20 mm of a stroke of 1.45 m. The loop is 1 + 0.8 + 0.5 ms late.
# A change of force by 2 x 25 kN is one from end to end. Readings 1e-5 m, brakes 1e-4 m, one tick: x 20 each.
BORDERS = {
    "force_N": (64000.0, 64200.0, "16022"),
    "force_step_N": (13500.0, 15000.0, "3590"),
    "force_window_N": (36000.0, 39000.0, "9320"),
    "speed_m_s": (4.5, 4.54, "1.129"),
    "acceleration_m_s2": (94.0, 125.0, None),
    "condition": (4.8 * 40, 4.9 * 40, "4.83"),
    "following_error_m": (0.0799, 0.0801, "0.02"),
    "following_error_s": (20 * 2.29e-3, 20 * 2.31e-3, "0.0023"),
    "consistency_m": (1.99e-4, 2.01e-4, "1e-05"),
    "standstill_m": (1.99e-3, 2.01e-3, "0.0001"),
    "stale_fault_ticks": (20, 21, "1"),
    "missed_stop_ticks": (20, 21, "1"),
}


def loose(subject, **limits):
    """Warnings about loose limits of a subject with other limits; its walk is not computed again."""
    other = copy.copy(subject)
    other.c = subject.c.model_copy(update={"limits": subject.c.limits.model_copy(update=limits)})
    return [text for code, text in warnings(other) if code == "limits"]


@pytest.fixture(scope="module")
def virtual():
    return looked_at(load("virtual"))


@pytest.mark.parametrize("name", BORDERS)
def test_check_warns_about_a_limit_far_above_the_needed_value_and_proposes_a_lower_one(virtual, name):
    tight, far, needed = BORDERS[name]
    assert loose(virtual, **{name: tight}) == []
    (line,) = loose(virtual, **{name: far})
    pattern = rf"limits\.{name} (\S+) is (\S+) times the (\S+) \S.* needed .*; it would detect .*, set (\S+)$"
    found = re.match(pattern, line)
    assert found is not None, line
    given, times, said, proposed = map(float, found.groups())
    assert given == pytest.approx(far, rel=1e-4)
    assert times == pytest.approx(far / said, rel=0.02)
    assert said < proposed < far
    assert needed is None or said == pytest.approx(float(needed), rel=0.01)
    assert loose(virtual, **{name: proposed}) == []


@pytest.mark.parametrize("name", ["acceleration_m_s2", "force_N", "force_step_N"])
def test_check_warns_about_a_limit_that_a_change_of_the_path_speed_would_exceed(virtual, name):
    slowed = virtual.slowed
    own, most = {
        "acceleration_m_s2": (float(abs(virtual.walk.ddq).max()), slowed.acceleration_m_s2),
        "force_N": (virtual.peak_N, slowed.force_N),
        "force_step_N": (virtual.own_step_N, virtual.own_step_N + slowed.step_N),
    }[name]
    assert own < most
    other = copy.copy(virtual)
    for limit, warns in ((0.9 * own + 0.1 * most, True), (1.001 * most, False)):
        limits = virtual.c.limits.model_copy(update={name: limit})
        other.c = virtual.c.model_copy(update={"limits": limits})
        found = [text for code, text in warnings(other) if code == "limits while operated"]
        assert len(found) == warns, found
        assert all(f"limits.{name}" in each and "engage.stop_s" in each for each in found)
