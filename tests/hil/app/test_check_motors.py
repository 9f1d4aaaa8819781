"""`hil check` from motor to leg and on the fused pose, against figures by hand."""

from math import pi
from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from tests.hil.app.texts import edited

pytestmark = pytest.mark.usefixtures("unproven")
EFFICIENCY = [0.9, 0.85, 0.8, 0.9, 1, 0.7]
MIXED = {
    "lead_m": [0.1, 0.1, 0.16, 0.1, 0.12, 0.1],
    "pulley_radius_m": None,
    "gear_ratio": [1, 1.25, 2, 1, 1.5, 1],
    "sign": [1, -1, 1, -1, -1, 1],
    "efficiency": EFFICIENCY,
}


def mixed(**changes):
    return loads(with_changes(load("desktop").text, {"drives": {"transmission": MIXED} | changes}), "my.yaml")


def test_each_leg_has_what_its_motor_reads_turns_and_gives():
    """q = 0.325 m + s l n / N, F = s 2 pi N tau / l; stroke 0.25 to 0.40 m, 0.25 m/s, 300 N rated."""
    report = inspect(mixed())
    figures, home = report.figures["transmission"], report.figures["home"]["static_forces_N"]
    assert figures["m_per_turn"] == pytest.approx([0.1, -0.08, 0.08, -0.1, -0.08, 0.1])
    assert figures["turns_retracted"] == pytest.approx([-0.75, 0.9375, -0.9375, 0.75, 0.9375, -0.75])
    assert figures["turns_extended"] == pytest.approx([0.75, -0.9375, 0.9375, -0.75, -0.9375, 0.75])
    assert figures["rpm"] == pytest.approx([150, 187.5, 187.5, 150, 187.5, 150])
    held = [h * m / (2 * pi) for h, m in zip(home, figures["m_per_turn"], strict=True)]
    assert figures["holding_Nm"] == pytest.approx(held)
    rated = [
        300 * m / (2 * pi) / e for m, e in zip([0.1, 0.08, 0.08, 0.1, 0.08, 0.1], EFFICIENCY, strict=True)
    ]
    assert figures["rated_Nm"] == pytest.approx(rated)
    lines = report.sections["motor to leg"]
    (second,) = [line for line in lines if line.startswith("1 ")]
    assert second.split()[1:6] == ["-80", "+0.9375", "to", "-0.9375", "78.54"]


def test_too_much_torque_is_refused_with_the_leg_that_needs_most():
    """Leg 5 alone loses 30 %: 300 N x 0.1 m / (2 pi x 0.7) = 6.82 N m; the DM4310 carries 10."""
    with pytest.raises(
        ConfigurationError, match=r"450 N need 10\.23 N m of the motor of leg 5 \(62\.83 N a N m"
    ):
        mixed(force_limit_N=450)


TITLE = "fused pose, standard deviations"
PLANT = "\nplant:\n"


def fused(name, *, plant=True, fusion="{}", changes=()):
    text = load(name).text
    if not plant:
        text = text[: text.index(PLANT)]
        text = text.replace("  interface: localcan", "  interface: socketcan")
    text = edited(*changes, base=text)
    added = f"sensors:\n  tracker: {{}}\nestimation:\n  pose: fused\n  fusion: {fusion}\n"
    return inspect(loads(text.replace("\nloop:\n", f"\n{added}\nloop:\n"), "my.yaml", Path()))


def test_it_prints_what_follows_from_encoders_rates_and_friction():
    assert fused("lab").sections[TITLE] == [
        "leg lengths    0.052 um",  # sqrt(0.15^2 + 0.1^2) / sqrt(12)
        "leg rates      0.0289 mm/s, 28.9 us of the acceleration, 0.58 % of the rate",
        "unknown forces 60 N over 100 ms",
    ]
