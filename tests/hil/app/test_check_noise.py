"""What `hil check` says of encoders so noisy that the rules on them have no effect."""

from __future__ import annotations

import pytest

from hil.app.check.command import inspect
from hil.app.configuration.configuration import load
from tests.broad import broad

pytestmark = pytest.mark.usefixtures("unproven")

STROKE_m = 0.45
"""Of `lab`."""


@pytest.mark.parametrize("noise_m", broad([1.1e-3, 0.9e-3, 2e-6, 0.022, 0.023], quick=2))
def test_noise_that_leaves_a_rule_without_effect_is_warned_of(noise_m):
    """A jump shows from twice the noise on; a leg that stands still is suspected from ten times the noise on."""
    c = load("lab")
    assert c.platform.length_max_m - c.platform.length_min_m == pytest.approx(STROKE_m)
    following_m = 0.01
    monitor = c.monitor.model_copy(update={"length_noise_m": noise_m, "friction_N": 0.0})
    limits = c.limits.model_copy(update={"following_error_m": following_m})
    found = inspect(c.model_copy(update={"monitor": monitor, "limits": limits})).warnings
    told = [each for each in found if each.startswith("monitor.length_noise_m")]
    assert any("jump" in each for each in told) == (2 * noise_m > 0.1 * STROKE_m)
    assert any("stands still" in each for each in told) == (10 * noise_m > following_m)
    assert all("largest deviation of a reading" in each for each in told)
