"""Limits of the encoder rules: detectable errors, undetectable errors, and probe pushes."""

from __future__ import annotations

import functools
import re
from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.signals import Doubt, DriveState, Mode
from hil.app.check.command import inspect, refuse_unreachable
from hil.app.check.demand import clipped
from hil.app.configuration.configuration import load, loads
from hil.app.derive_encoder_limits import encoder_limits, friction_N
from hil.app.reachability import Walk
from hil.app.unknown_payload import unknown_payload
from hil.contracts.records import record_of
from hil.safety import Safety
from tests.hil.encoder_bench import WIDE, six

pytestmark = pytest.mark.usefixtures("unproven")


def doubt_of(length: Array, rate: Array) -> Doubt:
    """Doubt of safety about leg 2 with the given readings, (n,) m and m/s at 1 kHz, on `virtual`.

    The other legs stand still, and the law follows the readings.
    """
    c = load("virtual")
    limits = encoder_limits(c, 1e3)
    safety = Safety(
        WIDE, drive_force_limit=1e6, length_min=-1e6, length_max=1e6, rate_Hz=1e3, encoders=limits
    )
    for n, (q, dq) in enumerate(zip(length, rate, strict=True)):
        lengths, rates = six(q, 2, other=1.5), six(dq, 2)
        tick = record_of(
            tick=n, t_ns=n * 1_000_000, mode=Mode.TRACKING, recorder_alive=1, condition=2.0, q=1.5, length=lengths,
            rate=rates, drive_state=DriveState.RUN, age=six(0, dtype=int), R=np.eye(3), J=np.eye(6), R_d=np.eye(3),
            q_d=lengths,
        )  # fmt: skip
        safety.judge(tick)
        if tick["legs_doubted"]:
            assert tick["legs_doubted"] == 1 << 2
            return Doubt(int(tick["doubt"]))
    return Doubt.NONE


@functools.cache
def printed() -> dict[str, Any]:
    """Figures that `hil check virtual` prints about encoders."""
    figures: dict[str, Any] = inspect(load("virtual")).figures["encoders"]
    return figures


T_S = 1e-3 * np.arange(3000)
SWING = 0.02 * np.sin(np.pi * T_S) ** 2, 0.02 * np.pi * np.sin(2.0 * np.pi * T_S)
"""Motion of a leg, m and m/s: 40 mm there and back within 1 s, at 63 mm/s at most."""


@pytest.mark.parametrize(("share", "found"), [(0.97, Doubt.NONE), (1.03, Doubt.SLIP)])
def test_encoder_length_drift_alone_is_detected_above_the_printed_speed(share, found):
    speed = share * printed()["drift_of_length_alone_m_s"]
    assert doubt_of(1.5 + speed * T_S, np.zeros(len(T_S))) is found


@pytest.mark.parametrize("speed_m_s", [0.005, 0.01, 0.019])
def test_encoder_drift_in_both_length_and_rate_is_undetected_during_motion(speed_m_s):
    way, rate = SWING
    drift = speed_m_s * np.maximum(T_S - 0.5, 0.0), speed_m_s * (T_S > 0.5)
    assert doubt_of(1.5 + way + drift[0], rate + drift[1]) is Doubt.NONE


def test_encoder_drift_that_starts_above_the_printed_rate_step_is_detected_as_a_rate_leap():
    step = 1.05 * printed()["leap_m_s"]
    drift = step * np.maximum(T_S - 0.5, 0.0), step * (T_S > 0.5)
    assert doubt_of(1.5 + drift[0], drift[1]) is Doubt.LEAP


@pytest.mark.parametrize("factor", [1.05, 1.3, 0.7])
def test_encoder_scale_error_common_to_length_and_rate_is_undetected(factor):
    way, rate = SWING
    assert doubt_of(1.5 + factor * way, factor * rate) is Doubt.NONE


@pytest.mark.parametrize(("share", "found"), [(0.95, Doubt.NONE), (1.08, Doubt.SLIP)])
def test_encoder_scale_error_of_the_rate_alone_is_detected_above_the_printed_share(share, found):
    """At constant speed; the scale error must exceed the detectable drift plus 1.6 %."""
    figures, speed = printed(), 0.2
    wrong = share * (figures["drift_of_length_alone_m_s"] / speed + figures["scale_of_rate_alone"])
    way = np.cumsum(np.minimum(T_S / 0.5, 1.0)) * 1e-3 * speed
    rate = np.minimum(T_S / 0.5, 1.0) * speed
    assert doubt_of(1.5 + way, (1.0 + wrong) * rate) is found


def test_force_of_a_probe_push_includes_the_losses_of_the_transmission():
    """F = 24 N of a leg at home; with eta_d 0.9 and eta_b 0.85: (F + 3 + m a) / 0.9 - (F - 3) 0.85."""
    c = load("desktop")
    assert c.drives.transmission is not None
    free = c.drives.transmission.model_copy(update={"efficiency": 1.0, "back_driving_efficiency": 1.0})
    lossless = c.model_copy(update={"drives": c.drives.model_copy(update={"transmission": free})})
    m_a = encoder_limits(lossless, 400.0).push_N - 6.0
    F = unknown_payload(c).holding_N
    assert np.ptp(F) < 1e-3 * F[0]
    expected = (F + 3.0 + m_a) / 0.9 - (F - 3.0) * 0.85
    np.testing.assert_allclose(encoder_limits(c, 400.0).push_N, expected, rtol=1e-12)


def test_leg_friction_is_the_configured_one_or_the_plants_or_5_percent_of_rated_force():
    assert friction_N(load("virtual")) == 0.0
    assert friction_N(load("lab")) == 60.0
    assert friction_N(load("socketcan")) == pytest.approx(75.0), "unknown friction: 5 % of rated 1.5 kN"
    c = load("lab")
    stated = c.model_copy(update={"monitor": c.monitor.model_copy(update={"friction_N": 25.0})})
    assert friction_N(stated) == 25.0


VIRTUAL = load("virtual")


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(1000.0, 6), (800.0, 6), (400.0, 4), (200.0, 3)])
def test_ticks_until_a_force_has_fully_acted_follow_from_the_loop_rate(rate_Hz, ticks):
    """One period to the drives, one of the tick, and five lags of 0.796 ms: 3.98 ms.

    At 400 Hz 2 x 2.5 + 3.98 ms are 3.6 ticks, at 800 Hz 2 x 1.25 + 3.98 ms are 5.2.
    """
    assert VIRTUAL.loop.rate_Hz == 1000.0
    assert encoder_limits(VIRTUAL, rate_Hz).acting_ticks == ticks


@pytest.mark.parametrize("rate_Hz", [400.0, 250.0])
def test_leg_rates_from_length_differences_add_two_ticks_until_a_force_has_fully_acted(rate_Hz):
    """A difference uses three lengths."""
    c = load("lab-cia402")
    ticks = {}
    for velocity in ("difference", "pdo"):
        drives = c.drives.model_copy(update={"options": c.drives.options | {"velocity": velocity}})
        limits = encoder_limits(c.model_copy(update={"drives": drives}), rate_Hz)
        assert limits.differences == (velocity == "difference")
        ticks[velocity] = limits.acting_ticks
    assert ticks["difference"] == ticks["pdo"] + 2


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(1000.0, 60), (500.0, 30)])
def test_encoder_rules_are_active_only_after_the_brake_release_time(rate_Hz, ticks):
    engage = VIRTUAL.engage.model_copy(update={"brake_release_s": 0.06, "brake_close_s": 0.2})
    c = VIRTUAL.model_copy(update={"engage": engage})
    assert encoder_limits(c, rate_Hz).open_ticks == ticks


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


def walked(force, swing=0.0):
    """A path of 1 s at 1 kHz with a force step of `swing` to `force`, N."""
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
def test_probe_push_beyond_a_force_limit_is_reported_with_the_key_of_that_limit(force, swing, friction, key):
    c = stated(load("lab"), friction)
    told = clipped(c, limits_of(c), walked(force, swing))
    assert (told is None) == (key is None)
    assert key is None or key in str(told)


def test_configured_friction_whose_probe_push_exceeds_a_limit_is_refused_with_its_bound():
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
