"""What `hil check` warns of: each danger at both sides of where it begins; no shipped file has one."""

import json
from pathlib import Path

import numpy as np
import pytest

from hil.app.check.command import inspect, stopping_distances_m
from hil.app.check.dangers import _coarse, _implausible
from hil.app.configuration.configuration import load, loads
from hil.app.force_steps import stepped_error_m

pytestmark = pytest.mark.usefixtures("unproven")

BOOK = json.loads((Path(__file__).parents[2] / "data/book_platform.json").read_text())
HEAVY = (("force_limit_N: 30000 ", "force_limit_N: 70000 "),)
"""Drives that can do more than the limits below."""


def warnings(name, *changes):
    text = load(name).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    others = ("SCHED_FIFO", "Unable to load schema")
    found = inspect(loads(text, "my.yaml")).warnings
    return [each for each in found if not any(other in each for other in others)]


def closing(seconds):
    return ("brake_close_s: 0.1 ", f"brake_close_s: {seconds} ")


# The book's path needs 16022 N and 1.129 m/s; vcan50 needs 1.875 x 0.1 m/s to reach its start.
DANGERS = [
    (
        "virtual",
        [closing(0.125)],
        [closing(0.135)],
        "drives.watchdog_ms 10 and engage.brake_close_s 0.135: after silence at t = 0.",
    ),
    (
        "virtual",
        [*HEAVY, ("force_N: 25000 ", "force_N: 64000 ")],
        [*HEAVY, ("force_N: 25000 ", "force_N: 64200 ")],
        "limits.force_N 64200 is 4.0 times the 1.6e+04 N that are needed",
    ),
    (
        "virtual",
        [("speed_m_s: 2 ", "speed_m_s: 4.49 ")],
        [("speed_m_s: 2 ", "speed_m_s: 4.55 ")],
        "limits.speed_m_s 4.55 is 4.0 times the 1.13 m/s that are needed",
    ),
    (
        "vcan50",
        [("speed_m_s: 0.6 ", "speed_m_s: 0.749 ")],
        [("speed_m_s: 0.6 ", "speed_m_s: 0.751 ")],
        "limits.speed_m_s 0.751 is 4.0 times the 0.188 m/s that are needed",
    ),
    (
        "virtual",
        [("silence: brake ", "silence: hold ")],
        [("silence: brake ", "silence: zero ")],
        "reactions.silence zero: after silence nothing holds the platform, whose legs carry up to ",
    ),
    (
        "virtual",
        [("following: sbc ", "following: ss1 ")],
        [("following: sbc ", "following: sto ")],
        "reactions sto after following: the platform falls until the brakes act",
    ),
    (
        "virtual",
        [("force_ramp_s: 0.3 ", "force_ramp_s: 0.01 ")],
        [("force_ramp_s: 0.3 ", "force_ramp_s: 0 ")],
        "engage.force_ramp_s 0: no brake is ever tested",
    ),
]


@pytest.mark.parametrize(("name", "harmless", "dangerous", "message"), DANGERS)
def test_a_danger_is_warned_of_from_where_it_begins(name, harmless, dangerous, message):
    assert warnings(name, *harmless) == []
    (warning,) = warnings(name, *dangerous)
    assert warning.startswith(message)


def test_lockstep_without_a_bus_endangers_nobody():
    assert warnings("ideal", ("blend_s: 0\n", "blend_s: 0\nreactions: {silence: zero}\n")) == []


@pytest.mark.parametrize(("closing_s", "leaves"), [(0.125, False), (0.135, True)])
def test_silence_drives_a_leg_into_its_end_where_the_books_lengths_and_rates_say_so(closing_s, leaves):
    """A leg of a platform that falls accelerates by a little more than 9.81 x 1 / 1.5925 = 6.2 m/s^2."""
    T, a = 0.01 + closing_s, 6.4
    q, dq = (np.array([state[key] for state in BOOK["states"]]) for key in ("length", "rate"))
    away = q + dq * T + a * T**2 / 2, q + dq * T - a * T**2 / 2
    assert (away[0].max() > 2.2 or away[1].min() < 0.75) == leaves
    assert bool(warnings("virtual", closing(closing_s))) == leaves


@pytest.mark.parametrize("name", ["lab", "vcan50", "virtual"])
def test_a_shipped_bench_gives_its_brakes_two_to_four_times_what_they_take_to_act(name):
    """They begin to act within it, and stop the legs: then the brakes are tested."""
    c = load(name)
    taken_ms = c.plant.drives.brake_close_ms  # type: ignore[union-attr]
    assert 2 * taken_ms <= 1e3 * c.engage.closing_s <= 4 * taken_ms


def test_the_printed_distance_is_speed_and_acceleration_over_watchdog_and_brake():
    """The distance is v T + a T^2 / 2: its mean speed rises in proportion to T, from the top speed on."""
    text = load("virtual").text
    T = np.array([0.04, 0.06, 0.1])
    closes = [text.replace(closing(0)[0], f"brake_close_s: {t - 0.01:g} ") for t in T]
    mean = np.array([stopping_distances_m(loads(each))[0] for each in closes]) / T
    rise = np.diff(mean) / np.diff(T)
    assert rise[1] == pytest.approx(rise[0], rel=1e-9)
    assert 9.81 / 1.5925 < 2 * rise[0] < 1.1 * 9.81 / 1.5925
    assert mean[0] - rise[0] * T[0] == pytest.approx(1.129, abs=1e-3)


def test_the_way_after_silence_names_its_time_and_the_keys_that_shorten_it():
    c = loads(load("virtual").text.replace(*closing(0.135)), "my.yaml")
    report = inspect(c)
    (lines,) = [lines for title, lines in report.sections.items() if title.startswith("reference")]
    told = " ".join(" ".join(lines).split())
    assert "until it rests on its brake, in 145 ms:" in told
    assert "drives.watchdog_ms and engage.brake_close_s" in told
    (warning,) = [each for each in report.warnings if "after silence at t" in each]
    assert "shorten drives.watchdog_ms, engage.brake_close_s" in warning


def test_drives_without_a_brake_and_without_a_watchdog_are_dangers():
    assert [w for w in warnings("lab") if w.startswith("drives.")] == []
    brake, homing = (w for w in warnings("desktop") if w.startswith("drives."))
    assert brake.startswith("drives.protocol: no frame of these drives works a brake, so a platform without")
    assert homing.startswith("drives.homing: left out, so after a power-off")
    kept = ("  watchdog_ms: 10 ", "  homing: {file: a.yaml, limit_m: 0.001}\n  watchdog_ms: 10 ")
    assert not any(w.startswith("drives.homing") for w in warnings("desktop", kept))
    cubemars = ("{variant: damiao, model: DM4310}", "{variant: cubemars, model: AK80-9}")
    found = [w for w in warnings("desktop", cubemars) if w.startswith("drives.watchdog_ms")]
    assert found[0].startswith("drives.watchdog_ms: cubemars has no watchdog that is set from here")


@pytest.mark.parametrize(
    ("radius_m", "words"),
    [
        (0.02, None),
        (0.5, "the whole stroke is 0.0477 turns of the motor, fewer than 0.1"),
        (5e-5, "limits.speed_m_s 0.25 is 4.77e+04 rpm of the motor, more than 30000"),
        (10.0, "limits.force_N 120 needs 1.2e+03 N m of the motor, more than 1000"),
    ],
)
def test_a_transmission_that_makes_no_motor_that_there_is_is_named(radius_m, words):
    c = load("desktop")
    assert c.drives.transmission is not None
    gear = c.drives.transmission.model_copy(update={"pulley_radius_m": radius_m})
    changed = c.model_copy(update={"drives": c.drives.model_copy(update={"transmission": gear})})
    found = list(_implausible(changed))
    assert bool(found) == (words is not None)
    assert words is None or any(words in each for each in found)


@pytest.mark.parametrize(
    ("options", "watched"),
    [
        ("{variant: damiao, model: DM4310}", True),
        ("{variant: cubemars, model: AK80-9}", False),
        ("{variant: mini_cheetah}", False),
    ],
)
def test_no_time_and_no_travel_after_silence_is_stated_of_drives_without_a_watchdog(options, watched):
    report = inspect(
        loads(load("desktop").text.replace("{variant: damiao, model: DM4310}", options), "my.yaml")
    )
    told = " ".join(" ".join(line for lines in report.sections.values() for line in lines).split())
    assert ("watchdog 10 ms, 4.0 periods; then brake" in told) == watched
    assert ("mm until it rests on its brake" in told) == watched
    assert ("they keep the last torque; cut their power now" in told) != watched
    assert ("no bound to a leg's travel" in told) != watched
    figures = report.figures["drives"], report.figures["reference"]["until_braked_m"]
    assert ((None not in figures[0].values()), figures[1] is not None) == (watched, watched)


@pytest.mark.parametrize(("lead_m", "coarse"), [(0.06, True), (0.2, False)])
def test_steps_of_the_force_that_lead_beyond_the_following_error_are_a_danger(lead_m, coarse):
    """By hand: 2 x 18 N m on 4095 steps, over 0.06 m a turn, are 0.92 N."""
    text = load("desktop").text
    transmission = text[text.index("  transmission:\n") : text.index("  watchdog_ms")]
    for old, new in (
        ("{variant: damiao, model: DM4310}", "{variant: cubemars, model: AK80-9}"),
        (transmission, f"  transmission: {{lead_m: {lead_m}, offset_m: 0.325}}\n"),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    c = loads(text, "my.yaml")
    report = inspect(c)
    step_N = 2 * 18 / 4095 * 2 * np.pi / lead_m
    assert report.figures["drives"]["force_step_N"] == pytest.approx(step_N, rel=1e-3)
    assert f"one step of the force is {step_N:.2g} N at the leg" in "\n".join(report.lines)
    strict = c.limits.model_copy(update={"following_error_m": 0.0003})
    warned = _coarse(c.model_copy(update={"limits": strict}))
    found = [each for each in warned if f"one code of torque is {step_N:.2g} N at the leg" in each]
    assert bool(found) == coarse


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize(
    ("radius_m", "words"),
    [(0.5, "0.0477 turns of"), (5e-5, "4.77e+04 rpm of"), (10.0, "needs 1.2e+03 N m of")],
)
def test_one_transmission_that_makes_no_motor_is_named_whichever_way_the_motors_turn(radius_m, words, leg):
    c = load("desktop")
    assert c.drives.transmission is not None
    radii = [radius_m if k == leg else 0.02 for k in range(6)]
    for sign in (1, -1):
        gear = c.drives.transmission.model_copy(update={"pulley_radius_m": radii, "sign": sign})
        changed = c.model_copy(update={"drives": c.drives.model_copy(update={"transmission": gear})})
        assert [each for each in _implausible(changed) if words in each], sign


@pytest.mark.parametrize("softest", range(6))
def test_steps_of_the_force_leave_the_softest_axis_of_a_pose_farthest_from_its_reference(softest):
    """What a step leaves is in proportion to 1 / wn^2: nine times as much at a third of the frequency."""
    c = loads(
        load("desktop").text.replace("  law: inverse_dynamics\n", "  law: pose_inverse_dynamics\n"), "a.yaml"
    )

    def left_m(wn: object) -> float:
        law = c.controller.model_copy(update={"wn_rad_s": wn})
        found = stepped_error_m(c.model_copy(update={"controller": law}))
        assert found is not None
        return found

    stiff_m = left_m(30.0)
    assert stiff_m > 0.0
    assert left_m([10.0 if k == softest else 30.0 for k in range(6)]) == pytest.approx(9.0 * stiff_m)
