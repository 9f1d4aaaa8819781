"""File of law `state_space`: problems with their place, and controllers that the loop cannot run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.configuration.configuration import loads
from hil.app.configuration.controller_file import read_controller
from tests.hil.app.texts import VIRTUAL, edited

GOOD = Path(__file__).parents[2] / "data" / "controller.yaml"


def changed(folder, old, new):
    path = folder / "mine.yaml"
    path.write_text(edited((old, new), base=GOOD.read_text()))
    return path


def bench(controller_file, folder, *, rate_Hz=1000, more=""):
    text = VIRTUAL
    a, b = text.index("\ncontroller:") + 1, text.index("\nengage:") + 1
    law = f"controller:\n  law: state_space\n  controller_file: {controller_file}\n{more}\n"
    text = f"{text[:a]}{law}{text[b:]}".replace("  periods: 10\n", "").replace(
        "rate_Hz: 1000 ", f"rate_Hz: {rate_Hz} "
    )
    return loads(text.replace("rate_Hz: 1000\n", f"rate_Hz: {rate_Hz}\n"), "bench.yaml", folder)


def refusal(*arguments, **options):
    with pytest.raises(ConfigurationError) as caught:
        bench(*arguments, **options)
    (problem,) = caught.value.problems
    return problem


WRONG = {
    "rate_Hz: 1000": ("rate_Hz: fast", r"mine.yaml:6:\d+: rate_Hz: wrong type, allowed: a number"),
    "[[1, 1]]": ("[[1, .nan]]", r"mine.yaml:10:\d+: C\[0\]\[1\]: not a finite number"),
    "anti_windup: [0, 0.2]": ("anti_windup: [0]", r"mine.yaml:.*anti_windup has 1 numbers, allowed: 2"),
    "design: {gamma: 1.0}": ("desing: {}", r"mine.yaml:13:\d+: desing: unknown key, did you mean design"),
    "[0, 1]]": ("[0, 1.01]]", r"mine.yaml:8:4: A: the sampled controller is unstable by itself.* 1.01;"),
}


def with_states(folder, A):
    """The controller with other states: (n, n), each driven by both errors."""
    n, text = len(A), GOOD.read_text()
    for key, value in {"A": A, "B": [[1, 1]] * n, "C": [[1] * n], "anti_windup": [0] * n}.items():
        text, count = re.subn(rf"\n{key}: .*", f"\n{key}: {value}", text)
        assert count == 1
    (folder / "mine.yaml").write_text(text)
    return read_controller(folder / "mine.yaml")


@pytest.mark.parametrize(
    "turned", [np.eye(3), np.array([[2, 1, 0], [-1, 3, 1], [0.5, 0, 1]])], ids=["", "turned"]
)
@pytest.mark.parametrize("chain", [1.0, 1e-3, 0.0])
def test_controller_file_is_refused_with_integrators_in_series_but_not_in_parallel(chain, turned, tmp_path):
    """Powers of [[1, c], [0, 1]] grow without bound, though both poles are 1; those of [[1, 0], [0, 1]] do not."""
    A = turned @ np.array([[1, chain, 0], [0, 1, 0], [0, 0, 0.5]]) @ np.linalg.inv(turned)
    if chain:
        with pytest.raises(ConfigurationError, match="integrates twice"):
            with_states(tmp_path, A.tolist())
    else:
        assert len(with_states(tmp_path, A.tolist()).A) == 3


@pytest.mark.parametrize("old", WRONG)
def test_mistake_in_a_controller_file_is_reported_with_line_and_column(old, tmp_path):
    new, message = WRONG[old]
    path = changed(tmp_path, old, new)
    with pytest.raises(ConfigurationError, match=message):
        read_controller(path)
    assert "controller.controller_file: " in refusal(path.name, tmp_path)


def test_controller_file_for_another_loop_rate_is_refused():
    message = refusal(GOOD, Path(), rate_Hz=500)
    assert "controller.controller_file: designed for 1000 Hz, but the loop runs at 500 Hz" in message
    assert "design the controller again" in message


def test_delay_compensation_with_a_state_space_law_is_refused_with_the_reason():
    message = refusal(GOOD, Path(), more="  delay_compensation: {bus_ms: 1}\n")
    assert "an axis that includes the delay" in message


def test_check_shows_order_and_margins_of_the_controller():
    """Compared with the continuous loop; the hold and a zero D matrix cost half a period each."""
    report = inspect(bench(GOOD, Path()))
    found = report.figures["controller"]
    assert found["order"] == 2
    assert any("order 2 on each joint axis" in line for line in report.lines)
    w_c, margin = crossing(delay_s=2e-3, lag_s=1 / (2 * np.pi * 200.0))
    assert found["cross_over_rad_s"] == pytest.approx(w_c, rel=1e-3)
    assert found["phase_margin_deg"] == pytest.approx(margin, abs=0.3)


def crossing(delay_s, lag_s):
    """Margins of ((40 s + 400) / (0.005 s + 1) + 2000 / s) / (lag s + 1) / s^2 e^(-delay s)."""

    def loop(w):
        s = 1j * w
        K = (40 * s + 400) / (0.005 * s + 1) + 2000 / s
        return K / (lag_s * s + 1) / s**2 * np.exp(-delay_s * s)

    w_c = brentq(lambda w: abs(loop(w)) - 1.0, 20.0, 100.0)
    return w_c, float(np.angle(-loop(w_c), deg=True))


def test_check_warns_about_a_delay_above_the_design_delay(tmp_path):
    """With ten times the gains it crosses over at 400 rad/s, where the lag of 5 ms alone costs 63 deg."""
    path = changed(tmp_path, "C: [[1, 1]]", "C: [[10, 10]]")
    report = inspect(bench(path.name, tmp_path))
    assert any("controller.controller_file: " in w for w in report.warnings)
