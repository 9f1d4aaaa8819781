"""What a leg may be pushed by: assumed from what legs may do, and refused where the limits would clip it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect, refuse_unreachable
from hil.app.check.pushes import clipped
from hil.app.configuration.configuration import load, loads
from hil.app.encoder_limits import encoder_limits, friction_N
from hil.app.reachability import Walk

pytestmark = pytest.mark.usefixtures("unproven")


def edited(name, *changes):
    c = load(name)
    text = c.text
    for old, new in changes:
        text, found = re.subn(old, new, text, flags=re.MULTILINE)
        assert found == 1, old
    return loads(text, "my.yaml", c.folder)


def limits_of(c):
    return encoder_limits(c, c.loop.rate_Hz)


def stated(c, friction):
    return c.model_copy(update={"monitor": c.monitor.model_copy(update={"friction_N": friction})})


@pytest.mark.parametrize(
    ("rated", "force", "window", "friction"),
    [
        (60_000, 1500, 1600, 75.0),
        (3000, 1500, 1600, 75.0),
        (1500, 1500, 1600, 75.0),
        (3000, 400, 1600, 20.0),
        (3000, 1500, 600, 30.0),
    ],
)
def test_unstated_friction_is_a_twentieth_of_the_largest_force(rated, force, window, friction):
    c = load("socketcan")
    drives = c.drives.model_copy(update={"force_limit_N": rated})
    asked = c.limits.model_copy(update={"force_N": force, "force_window_N": window})
    assert friction_N(c.model_copy(update={"drives": drives, "limits": asked})) == pytest.approx(friction)


def walked(force, swing=0.0):
    """A path of 1 s at 1 kHz whose forces change by `swing` to `force`, N."""
    n = 1001
    t, tau, nothing = np.linspace(0, 1, n), np.full((n, 6), force), np.zeros((n, 6))
    tau[: n // 2, 2] -= swing
    return Walk(t, nothing, nothing, nothing, tau, tau[[0, -1]], t, t, True, False)


# lab: 2500 N, window 2000 N, 10 mm; a push of twice the friction and some 127 N
@pytest.mark.parametrize(
    ("force", "swing", "friction", "key"),
    [
        (1400.0, 0.0, 480.0, None),
        (1400.0, 0.0, 490.0, "limits.force_N 2500"),
        (1500.0, 1300.0, 280.0, None),
        (1500.0, 1300.0, 292.0, "limits.force_window_N 2000"),
        (-1600.0, 0.0, 380.0, None),
        (-1600.0, 0.0, 390.0, "limits.force_N 2500"),
    ],
)
def test_a_push_that_the_limits_would_clip_is_reported(force, swing, friction, key):
    c = stated(load("lab"), friction)
    told = clipped(c, limits_of(c), walked(force, swing))
    assert (told is None) == (key is None)
    assert key is None or key in str(told)


def test_a_clipped_push_refuses_a_run_with_the_value_that_is_allowed():
    c = edited("lab", (r"^monitor:.*", "monitor:\n  friction_N: 900"))
    line = c.text[: c.text.index("friction_N: 900")].count("\n") + 1
    for entry in (refuse_unreachable, inspect):
        with pytest.raises(ConfigurationError) as caught:
            entry(c)
        (problem,) = caught.value.problems
        assert problem.startswith(f"my.yaml:{line}:3: monitor.friction_N: ")
        allowed = float(re.findall(r"allowed: at most ([\d.]+) N", problem)[0])
        assert "given: 900 N" in problem
        assert "raise limits.force_" in problem
    refuse_unreachable(stated(c, 0.99 * allowed))
    with pytest.raises(ConfigurationError):
        refuse_unreachable(stated(c, 1.01 * allowed + 1.0))
