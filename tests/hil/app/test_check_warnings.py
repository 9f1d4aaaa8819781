"""Warnings of `hil check`: each dangerous setting at both sides of its border."""

from __future__ import annotations

from typing import Any

import pytest

from hil.app.check.command import inspect
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from tests.broad import broad
from tests.hil.app.test_configs import NAMES

pytestmark = pytest.mark.usefixtures("unproven")


def warnings(name: str, changes: dict[str, Any]) -> list[str]:
    c = load(name)
    return inspect(loads(with_changes(c.text, changes), "my.yaml", c.folder)).warnings


def limit(key: str, harmless: object, dangerous: object) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"limits": {key: harmless}}, {"limits": {key: dangerous}}


def value(
    section: str, key: str, harmless: object, dangerous: object
) -> tuple[dict[str, Any], dict[str, Any]]:
    return {section: {key: harmless}}, {section: {key: dangerous}}


def bench(harmless: dict[str, Any], dangerous: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"plant": harmless}, {"plant": dangerous}


SLIDING = {
    "law": "sliding_mode", "lambda_rad_s": 92, "reaching_m_s2": 1, "model": {"variant": "full"},
    "uncertainty": {"disturbance_m_s2": 13, "model_error": 0.1, "acceleration_m_s2": 12},
}  # fmt: skip
FAR = {"limits": {"following_error_m": 0.5}}
FROZEN = {"variant": "constant", "frozen_at": {"position_m": [0, 0, 1]}}
CUBEMARS = {"drives": {"options": {"variant": "cubemars", "model": "AK80-9"}}}
# The book's path needs 16022 N and 1.129 m/s; vcan50 needs 1.875 x 0.1 m/s to reach its start; virtual's legs
# carry 3619 N at rest; lab has a stroke of 0.45 m and a following error of 10 mm.
WARNINGS = {
    "brakes too slow": ("virtual", *value("engage", "brake_close_s", 0.125, 0.135), "after silence at t = 0."),
    "speed far above need": ("vcan50", *limit("speed_m_s", 0.749, 0.751), "4.0 times the 0.188 m/s"),
    "little force left": ("virtual", *limit("force_N", 18000, 17000), "less than 10 % is left"),
    "nothing holds after silence": ("virtual", *value("reactions", "silence", "hold", "zero"), "reactions.silence zero"),
    "platform falls": ("virtual", *value("reactions", "following", "ss1", "sto"), "reactions sto after following"),
    "brakes never tested": ("virtual", *value("engage", "force_ramp_s", 0.01, 0), "engage.force_ramp_s 0"),
    "brakes slip": (
        "virtual", *bench({"model": {"brake_force_N": 3620}}, {"model": {"brake_force_N": 3618}}),
        "plant.model.brake_force_N 3618 is below",
    ),
    "brakes open at once": (
        "bench", *bench({"drives": {"brake_open_ms": 0.1}}, {"drives": {"brake_open_ms": 0}}),
        "plant.drives.brake_open_ms 0: ",
    ),
    "a jump is never found": (
        "lab", {"monitor": {"length_noise_m": 0.022, "friction_N": 0}} | FAR,
        {"monitor": {"length_noise_m": 0.023, "friction_N": 0}} | FAR, "jump",
    ),
    "a leg at rest is suspected": (
        "lab", {"monitor": {"length_noise_m": 0.9e-3, "friction_N": 0}},
        {"monitor": {"length_noise_m": 1.1e-3, "friction_N": 0}}, "stands still",
    ),
    "rated force not stated": (
        "socketcan", {"drives": {"force_limit_N": 60000}}, {"drives": {"force_limit_N": None}},
        "drives.force_limit_N is not stated",
    ),
    "model frozen": ("virtual", {}, {"controller": {"model": FROZEN}}, "good for small motion only"),
    "model of the notes": ("virtual", {}, {"controller": {"model": {"variant": "printed"}}}, "variant printed: "),
    "too little phase": ("virtual", {}, {"controller": {"wn_rad_s": 200}}, "phase margin"),
    "switching law": (
        "virtual", {"controller": SLIDING}, {"controller": SLIDING | {"boundary_layer_m_s": 0}}, "it chatters",
    ),
    "window too short": ("virtual", *value("loop", "feedback_window_us", 500, 400), "six feedbacks take 463 us"),
    "unknown interface": ("virtual", *value("bus", "interface", "pcan", "sockercan"), "bus.interface: sockercan"),
    "turns forgotten": (
        "desktop", {"drives": {"homing": {"file": "a.yaml", "limit_m": 0.001}}}, {}, "drives.homing: left out",
    ),
    "no watchdog": ("desktop", {}, CUBEMARS, "cubemars has no watchdog"),
    "jog too fast": ("virtual", *value("operator", "setup_speed_m_s", 0.05, 2.5), "a leg"),
    "key that the page cannot hold": (
        "virtual", {"watch": {"operate": True}, "operator": {"deadman_s": 0.15}},
        {"watch": {"operate": True}, "operator": {"deadman_s": 0.14}}, "the page of",
    ),
    "key that is lost at each late word": (
        "virtual", *value("operator", "deadman_s", 0.06, 0.059), "comes late or is lost",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("name", "harmless", "dangerous", "words"), WARNINGS.values(), ids=WARNINGS)
def test_a_dangerous_setting_is_warned_about_from_its_border_on(name, harmless, dangerous, words):
    assert not [each for each in warnings(name, harmless) if words in each]
    assert [each for each in warnings(name, dangerous) if words in each]


@pytest.mark.parametrize("name", broad(NAMES, quick=3))
def test_no_shipped_configuration_has_a_dangerous_limit(name):
    late = (
        "would show a failure late",
        "after silence at t",
        "phase margin",
        "is left",
        "drives.force_limit_N",
    )
    assert not [each for each in inspect(load(name)).warnings if any(words in each for words in late)]


def test_lockstep_without_a_bus_endangers_nobody():
    assert not [each for each in warnings("ideal", {"reactions": {"silence": "zero"}}) if "silence" in each]
