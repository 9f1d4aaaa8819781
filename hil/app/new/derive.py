"""Values of a new configuration that follow from the answers to `hil new`, each by a stated rule."""

from __future__ import annotations

from math import ceil, degrees, pi
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.mit.fields import TURN
from drivers.sensing.settings import SensorSettings
from drivers.signals import LEGS
from hil.app.configuration.bus_budget import bus_budgets
from hil.app.derive_encoder_limits import PUSH, REACHES_BACK
from hil.app.new import drives
from hil.app.new.robot import Answers, AtHome, platform_settings, platform_values, robot_at_home
from hil.app.new.template import settings
from hil.app.reachability import Walk, span_s, walk, window_swing
from hil.app.unknown_payload import error_m
from hil.config.limits import MonitorSettings
from hil.config.reference import SinusoidReference
from hil.config.running import OperatorSettings
from hil.mathematics.rounding import lowered, raised, rounded
from hil.safety.guard import WINDOW_S
from hil.safety.residuals import MOVED
from hil.trajectory.build import build_trajectory

RATES_Hz = (1000.0, 500.0, 400.0, 312.5, 250.0, 200.0, 100.0)
"""Candidate rates; the first that fits the bus is used."""
CHANNELS = ("1", "2", "3", "6")
"""Numbers of buses that divide the legs evenly."""
SLOW_PLANT = "slow_plant"
"""Key of a value known before the first question: the plant is an FMU that needs its tool to run."""
SLOW_Hz = 250
"""For an FMU that needs its tool, mostly an interpreter: 0.5 ms a step is too slow for 1 kHz."""
LAG_Hz = 200.0
"""Bandwidth of the force loop of the emulated drives."""
PHASE_deg = 10.0
"""Largest phase loss by the loop's delay at the crossover of the error dynamics."""
CROSSOVER = 2.06
"""Crossover of e'' + 2 wn e' + wn^2 e = 0, in wn."""
EXCURSION = 0.2
"""Largest excursion of a leg from its middle on the path, as a share of the stroke."""
FADE = 0.4
"""Shortest fade of the path, in its periods: 1.875 x / t is then 0.75 of the rate 2 pi f x."""
SLOWEST_Hz = 8.4e-4
"""Lowest frequency of a path: three periods take an hour. Slower drives move a leg by less."""
MOST_FORCE = 3.8
"""Largest limits.force_N, in the need of the path; `hil check` warns from 4 on."""
HOLD_Hz = 5.0
"""Bandwidth of an emulated drive's own reactions."""
ROOM = 1.01
"""Ratio of proposed to least travel a turn: the file has rounded numbers."""


def values(a: Answers) -> dict[str, Any]:
    """All values of the configuration template except name and plant, from all answers."""
    home, rate_Hz = robot_at_home(a), a["rate_Hz"]
    found = platform_values(a) | frames(a, rate_Hz) | path(a, home)
    approach = lowered(min(0.1 * a["drive_speed_m_s"], 0.25 * a["stroke_m"]))
    found |= limits(a, home, walked(a, found), approach)
    speed, room = found["speed_m_s"], 0.8 * found["speed_m_s"]
    length, rate = steps(a, rate_Hz)
    noise, usual, hold = raised(1.5 * rate) if rate else 0.0, OperatorSettings(), 2.0 * pi * HOLD_Hz
    mounting = a["mounting"] if isinstance(a["mounting"], str) else f"gravity {a['mounting']}"
    return found | {
        "description": f"{a['mass_kg']:g} kg, {mounting}, six legs of {a['stroke_m']:g} m stroke.",
        "wn_rad_s": wn_rad_s(rate_Hz),
        "length_noise_m": rounded(2.0 * length),
        "rate_noise_m_s": noise if noise > MonitorSettings().rate_noise_m_s else None,
        "brake_release_s": raised(2e-3 * a["brake_ms"]),
        "brake_close_s": closing_s(a, home, speed),
        "approach_m_s": approach,
        "setup_speed_m_s": min(usual.setup_speed_m_s, lowered(room)),
        "setup_speed_deg_s": min(usual.setup_speed_deg_s, lowered(degrees(room / a["platform_radius_m"]))),
        "counts_itself": drives.counts_itself(a),
        "counted": not drives.counts_itself(a),
        "damping_N_s_m": rounded(2.0 * home.leg_mass_kg * hold),
        "hold_stiffness_N_m": rounded(home.leg_mass_kg * hold**2),
    }


def frames(a: Answers, rate_Hz: float) -> dict[str, Any]:
    """Values of sections `bus` (neighbouring legs share a bus), `drives` and `reactions`."""
    stem, n, own = "hil" if a["interface"] == "localcan" else "can", int(a["channels"]), drives.family(a)
    legs = np.arange(LEGS).reshape(n, -1).tolist()
    found: dict[str, Any] = {
        **a,
        "channel": f"{stem}0" if n == 1 else None,
        **{f"bus_{k}": {"channel": f"{stem}{k}", "legs": those} for k, those in enumerate(legs) if n > 1},
        "fd": a["layout"] == "fd",
        "protocol": own.protocol,
        own.protocol: True,
        "silence": own.silence,
        "watchdog_ms": max(10.0, float(ceil(5e3 / rate_Hz))),
    }
    if drives.bought(a):
        travel = a["travel_m"]
        found |= {
            "bought": True,
            # 0.5 % more, as it is rounded
            "torque_N_m": float(f"{1.005 * a['drive_force_N'] * travel / TURN:.3g}"),
            "counts_per_turn": max(1, round(travel / a["encoder_resolution_m"])),
            "model": drives.models(a) and drives.model(a),
            "middle_m": a["length_min_m"] + a["stroke_m"] / 2,
        }
    return found


def _frames_of(a: Answers, rate_Hz: float) -> tuple[BusSettings, DriveSettings]:
    found = frames(a, rate_Hz)
    return BusSettings(**settings("bus", found)), DriveSettings(**settings("drives", found))


def loop_rate_Hz(a: Answers) -> float:
    """Highest rate in `RATES_Hz` whose frames fit the bus; for a slow plant at most `SLOW_Hz`."""
    tried = [rate for rate in RATES_Hz if rate <= SLOW_Hz or not a.get(SLOW_PLANT)]
    return next((rate for rate in tried if bus_trouble(a, rate) is None), tried[-1])


def bus_trouble(a: Answers, rate_Hz: float) -> str | None:
    """Reason why the drives' frames do not fit the bus at a loop rate; None if they fit."""
    try:
        bus_budgets(*_frames_of(a, rate_Hz), SensorSettings(), rate_Hz)
    except ConfigurationError as error:
        return str(error)
    return None


def rate_trouble(a: Answers) -> str | None:
    """Reason why bus or force resolution forbid a loop rate, with advice; None if the rate is allowed."""
    rate_Hz = a["rate_Hz"]
    if trouble := bus_trouble(a, rate_Hz):
        more = [n for n in CHANNELS if int(n) > int(a["channels"])]
        enough = next((n for n in more if bus_trouble(a | {"channels": n}, rate_Hz) is None), None)
        return f"{trouble}; here --channels {enough} is enough" if enough else trouble
    finest_m = _finest_m(a, rate_Hz)
    if not drives.bought(a) or a["travel_m"] >= finest_m:
        return None
    return (
        f"at {rate_Hz:g} Hz one code of torque is {drives.force_step_N(a, a['travel_m']):.2g} N at the "
        f"leg and leaves an error above 2 % of the stroke: use a higher rate, or --travel "
        f"of at least {finest_m:.4g} m a turn"
    )


def travel_trouble(a: Answers) -> str | None:
    """Reason why the leg travel per motor turn does not suit stroke, torque or error limit; else None."""
    if not drives.models(a):
        return drives.travel_trouble(a, 0.0)
    assumed = {"layout": drives.family(a).layout, "channels": "1"} | a
    rate_Hz = loop_rate_Hz(assumed | {"travel_m": drives.travels_m(a)[1]})
    return drives.travel_trouble(a, _finest_m(a, rate_Hz))


def _finest_m(a: Answers, rate_Hz: float) -> float:
    """Least leg travel per turn, m, whose force resolution keeps the leg error in its limit; 0: unknown."""
    if not drives.models(a):
        return 0.0
    home = robot_at_home(a)
    P = home.J @ np.linalg.solve(home.model.mass_matrix(*home.pose), home.J.T)
    # force resolution = torque resolution / travel a turn
    at_a_metre_m = error_m(P, np.full(6, drives.force_step_N(a, 1.0)), wn_rad_s(rate_Hz) ** 2)
    return ROOM * at_a_metre_m / rounded(0.02 * a["stroke_m"])


def wn_rad_s(rate_Hz: float) -> float:
    """Natural frequency of the error dynamics, rad/s, for which the loop's delay costs `PHASE_deg` of phase.

    It is low enough for every pose. Delay: one period to the drives, half a period of hold, the drives' lag.
    """
    delay_s = 1.5 / rate_Hz + 1.0 / (2.0 * pi * LAG_Hz)
    return lowered(np.deg2rad(PHASE_deg) / (CROSSOVER * delay_s))


def path(a: Answers, home: AtHome) -> dict[str, Any]:
    """Values of section `reference`: a path about home, an hour at most, within `EXCURSION` of each stroke.

    The fastest leg uses at most a quarter of the drives' speed, and up to a half while a slow path fades out.
    The largest acceleration is 1 m/s^2, or what a tenth of the force left after holding can give.
    """
    r = a["platform_radius_m"]
    directions = np.abs(home.J[:, [0, 2, 4]]) * [1.0, 1.0, 1.0 / r]
    free_N = a["drive_force_N"] - home.held_N
    speed, acceleration = 0.25 * a["drive_speed_m_s"], min(1.0, 0.1 * free_N / home.leg_mass_kg)
    slowest = 2 * pi * SLOWEST_Hz
    excursion = min(EXCURSION * a["stroke_m"], speed / slowest, acceleration / slowest**2)
    amplitude = excursion / float(directions.sum(axis=1).max())
    f = lowered(min(0.5, speed / (2 * pi * excursion), np.sqrt(acceleration / excursion) / (2 * pi)))
    return {
        "duration_s": max(10.0, ceil(3.0 / f)),
        "ramp_s": max(2.0, rounded(FADE / f)),
        "amplitude_m": lowered(amplitude),
        "amplitude_deg": lowered(np.rad2deg(amplitude / r)),
        "f_z_Hz": f,
        "f_x_Hz": rounded(0.5 * f),
        "f_ry_Hz": rounded(0.7 * f),
    }


def walked(a: Answers, found: dict[str, Any]) -> Walk:
    """Leg lengths, rates and forces along the path with these template values."""
    home, period_s = robot_at_home(a), 1.0 / a["rate_Hz"]
    reference = TypeAdapter(SinusoidReference).validate_python(settings("reference", found))
    trajectory = build_trajectory(reference, platform_settings(a).home, Path(), period_s)
    return walk(home.platform, home.model, trajectory, span_s(trajectory), period_s)


def steps(a: Answers, rate_Hz: float) -> tuple[float, float]:
    """(length m, rate m/s): quantisation errors of leg readings, by encoder and frames."""
    read = build_protocol(*_frames_of(a, rate_Hz)).traits.resolution.at(rate_Hz)
    return max(float(read.length.max()), float(a["encoder_resolution_m"])), float(read.rate.max())


def following_m(a: Answers, home: AtHome) -> float:
    """Following error limit, m: 2 % of the stroke, or 1.5 times the error that dry friction may leave."""
    P = home.J @ np.linalg.solve(home.model.mass_matrix(*home.pose), home.J.T)
    stuck = error_m(P, np.full(LEGS, a["coulomb_friction_N"]), wn_rad_s(a["rate_Hz"]) ** 2)
    return max(rounded(0.02 * a["stroke_m"]), raised(1.5 * stuck) if stuck else 0.0)


def free_push_N(a: Answers, home: AtHome) -> float:
    """Largest probe push, N, that moves a leg without friction by less than limits.following_error_m."""
    traits = build_protocol(*_frames_of(a, a["rate_Hz"])).traits
    back = REACHES_BACK * int(traits.resolution.differences)
    ticks = ceil(2.0 + traits.command_delay_ticks + 5.0 * a["rate_Hz"] / (2.0 * pi * LAG_Hz)) + back
    P = home.J @ np.linalg.solve(home.model.mass_matrix(*home.pose), home.J.T)
    seen_m = 4.0 * MOVED * steps(a, a["rate_Hz"])[0]  # twice the resolution, as monitor.length_noise_m
    beside = max(np.sqrt(following_m(a, home)) - np.sqrt(seen_m), 0.0) * a["rate_Hz"] / ticks
    return float(beside**2 / np.diag(P).max())


def limits(a: Answers, home: AtHome, w: Walk, approach_m_s: float) -> dict[str, Any]:
    """Values of section `limits`: needs of path and approach with a margin, at most the drives' ratings."""
    rate_Hz, stroke = a["rate_Hz"], a["stroke_m"]
    most, friction = float(np.abs(w.tau).max()), a["coulomb_friction_N"]
    force, push, allowed = 2.5 * most, 0.0, MonitorSettings().disturbance_m_s2
    moved = 1.1 * PUSH[True] * home.leg_mass_kg
    if friction > 0.0:  # room for the probe push on a leg at rest: friction, and a share of the disturbance
        least = most + 2.2 * friction
        force = max(force, least, min(MOST_FORCE * most, least + moved * allowed))
        spare = min(min(a["drive_force_N"], force) - least, free_push_N(a, home) - 2.2 * friction)
        allowed = lowered(min(allowed, max(0.1, spare / moved)))
        push = 2.2 * friction + moved * allowed
    force = min(a["drive_force_N"], raised(force))
    needed = max(float(np.abs(w.dq).max()), 1.875 * approach_m_s)
    swing = float(window_swing(w.tau, max(1, round(WINDOW_S * rate_Hz))).max())
    free = max(force - home.held_N, 0.1 * force)
    return {
        "force_N": force,
        "disturbance_m_s2": allowed if friction > 0.0 else None,
        "force_step_N": raised(0.2 * force + 2.0 * friction),
        "force_window_N": raised(max(force, 2.0 * swing, swing + push)),
        "speed_m_s": min(a["drive_speed_m_s"], raised(2.5 * needed)),
        "deceleration_m_s2": lowered(0.5 * free / home.leg_mass_kg),
        "stroke_margin_m": rounded(0.02 * stroke),
        "following_error_m": following_m(a, home),
        "standstill_m": raised(max(min(5e-4, 0.01 * stroke), 4 * steps(a, rate_Hz)[0]), 3),
    }


def closing_s(a: Answers, home: AtHome, speed_m_s: float) -> float:
    """Longest time until a brake holds the fastest leg, s: t + m v / (brake - weight), with a margin."""
    spare_N = max(a["brake_force_N"] - home.held_N, 0.05 * a["brake_force_N"])
    return raised(1.2 * (1e-3 * a["brake_ms"] + home.leg_mass_kg * speed_m_s / spare_N))
