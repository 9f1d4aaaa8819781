"""`hil stability`: the bound includes resolution and losses of the drives."""

from __future__ import annotations

from pathlib import Path

import pytest

import configs
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.app.sim.command import simulate
from hil.app.stability.command import judge
from tools.drive_families import FAMILIES, NO_FRICTION, NO_LOSS, merged

SHIPPED = (Path(str(configs.__file__)).parent / "desktop.yaml").read_text(encoding="utf-8")
SMOOTH = {"plant": {"model": NO_FRICTION}}
LOSSLESS = merged(SMOOTH, {"drives": {"transmission": NO_LOSS}})
COARSE = {
    "drives": {
        "options": {
            "variant": "mini_cheetah", "model": None, "position_rad": 125.0, "velocity_rad_s": 300.0,
        }
    }
}  # fmt: skip
SLIGHT = merged(SMOOTH, {"drives": {"transmission": {"efficiency": 0.98, "back_driving_efficiency": 0.98}}})


def desktop(*changes):
    """The shipped configuration with changes."""
    return loads(with_changes(SHIPPED, merged(*changes)), "changed.yaml")


def bound_mm(c):
    """The printed bound of the legs."""
    found = judge(c)
    assert found.status == "conditional", found.claim
    return 1e3 * max(found.figures["ultimate_bound"])


def test_stability_bound_grows_with_resolution_and_losses_of_the_drives():
    fine, lossy, coarse = (bound_mm(desktop(each)) for each in (LOSSLESS, SLIGHT, merged(LOSSLESS, COARSE)))
    assert 0.0525 < fine < 0.3, "52.5 um are met in 20 s"
    assert lossy > 2.0 * fine
    assert coarse > 2.0 * fine


def test_stability_prints_no_bound_if_transmission_losses_are_too_large():
    found = judge(desktop(SMOOTH))
    assert found.status == "not proven"
    assert "no bound" in found.claim
    assert "transmission with lower losses" in found.claim


@pytest.mark.long
@pytest.mark.parametrize(
    "changes",
    [
        *(merged(each, SMOOTH if name.startswith("legs") else LOSSLESS) for name, each in FAMILIES.items()),
        SLIGHT,
        {"drives": {"transmission": NO_LOSS}},
        merged(LOSSLESS, COARSE),
    ],
)
def test_peak_leg_error_of_a_simulation_stays_below_the_printed_stability_bound(changes, tmp_path):
    c = desktop(changes)
    summary = simulate(c, log=tmp_path / "run.mcap")
    assert summary["success"], summary["trouble"]
    assert summary["tracking"]["peak_leg_error_mm"] < bound_mm(c)
