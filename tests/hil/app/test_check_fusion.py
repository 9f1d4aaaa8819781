"""What `hil check` says of the fused pose."""

from pathlib import Path

import pytest

from hil.app.check.command import inspect
from hil.app.configuration.configuration import load, loads

pytestmark = pytest.mark.usefixtures("unproven")

TITLE = "fused pose, standard deviations"
PLANT = "\nplant:\n"
ASSUMED = "(assumed); state monitor.friction_N or estimation.fusion.leg_force_std_N as measured"


def fused(name, *, plant=True, fusion="{}", changes=()):
    text = load(name).text
    if not plant:
        text = text[: text.index(PLANT)]
        text = text.replace("  interface: localcan", "  interface: socketcan")
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    added = f"sensors:\n  tracker: {{}}\nestimation:\n  pose: fused\n  fusion: {fusion}\n"
    return inspect(loads(text.replace("\nloop:\n", f"\n{added}\nloop:\n"), "my.yaml", Path()))


def test_it_prints_what_follows_from_encoders_rates_and_friction():
    assert fused("lab").sections[TITLE] == [
        "leg lengths    0.052 um",  # sqrt(0.15^2 + 0.1^2) / sqrt(12)
        "leg rates      0.0289 mm/s, 28.9 us of the acceleration, 0.58 % of the rate",
        "unknown forces 60 N over 100 ms",
    ]


@pytest.mark.parametrize("unstated", [True, False])
def test_friction_that_nobody_states_is_assumed_and_asked_for(unstated):
    stated = ("action: warn", "action: warn\n  friction_N: 100")
    found = fused("lab", plant=False, changes=[] if unstated else [stated])
    assert found.sections[TITLE][2].startswith("unknown forces 100 N over 100 ms")
    assert found.sections[TITLE][2].endswith(ASSUMED) == unstated


def test_a_force_of_zero_is_called_by_its_name():
    found = fused("lab", fusion="{leg_force_std_N: 0}")
    assert found.sections[TITLE][2].startswith("unknown forces none: the model is taken at its word")
    assert found.figures["fusion"]["force_std_N"] == 0.0


def test_without_a_fused_pose_there_is_nothing_to_say():
    assert TITLE not in inspect(load("lab")).sections
