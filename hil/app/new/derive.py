"""Every number of `hil new` that nobody was asked for, each by one stated rule."""

from __future__ import annotations

from decimal import Decimal
from math import ceil, degrees, pi
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings, SensorSettings
from drivers.errors import ConfigurationError
from drivers.signals import LEGS
from hil.app.configuration.bus_budget import bus_budget
from hil.app.new.drives import counts_itself, drives_section
from hil.app.new.robot import AtHome, platform_section, robot_at_home
from hil.app.reachability import Walk, span_s, walk, window_swing
from hil.config.monitor import MonitorSettings
from hil.config.operator import OperatorSettings
from hil.config.platform import PlatformSettings
from hil.config.reference import SinusoidReference
from hil.mathematics.rounding import lowered, raised, rounded
from hil.safety.guard import WINDOW_S
from hil.trajectory.build import build_trajectory

RATES_Hz = (1000.0, 500.0, 400.0, 312.5, 250.0, 200.0, 100.0)
"""Rates that are tried, the first that fits the bus is taken."""
CHANNELS = ("1", "2", "3", "6")
"""Numbers of buses that share the legs out evenly."""
SLOW_Hz = 250
"""For an FMU that needs its tool, mostly an interpreter: half a millisecond a step leaves 1 kHz no room."""
LAG_Hz = 200.0
"""Force loop of the emulated drives."""
PHASE_deg = 10.0
"""What the loop's delay may cost at the crossover of the error dynamics."""
CROSSOVER = 2.06
"""Of e'' + 2 wn e' + wn^2 e = 0, in wn."""
EXCURSION = 0.2
"""Of the stroke, what the path moves a leg from the middle."""
FADE = 0.4
"""Of a period of the path, that it takes to fade at least: 1.875 x / t is then 0.75 of the rate 2 pi f x."""
SLOWEST_Hz = 8.4e-4
"""Of a path, three periods of which take no more than an hour: slower drives move a leg by less."""
HOLD_Hz = 5.0
"""Bandwidth of what an emulated drive does by itself."""


def bus_section(a: dict[str, Any]) -> dict[str, Any]:
    """Return section `bus`: neighbouring legs share a bus."""
    stem, n = "hil" if a["interface"] == "localcan" else "can", int(a["channels"])
    bus = {"interface": a["interface"], "channel": f"{stem}0"}
    each = LEGS // n
    if n > 1:
        legs = [list(range(k * each, (k + 1) * each)) for k in range(n)]
        several = [{"channel": f"{stem}{k}", "legs": own} for k, own in enumerate(legs)]
        bus = {"interface": a["interface"], "channels": several}
    bus |= {"layout": a["layout"], "bitrate_bit_s": 1_000_000}
    return bus | ({"data_bitrate_bit_s": 5_000_000} if a["layout"] == "fd" else {})


def loop_rate_Hz(a: dict[str, Any], *, slow: bool) -> float:
    """Return the highest of `RATES_Hz` whose frames fit the bus; for a slow plant at most `SLOW_Hz`."""
    tried = [rate for rate in RATES_Hz if rate <= SLOW_Hz or not slow]
    return next((rate for rate in tried if rate_trouble(a, rate) is None), tried[-1])


def rate_trouble(a: dict[str, Any], rate_Hz: float) -> str | None:
    """Return why the bus does not carry the drives' frames at a rate; None where it does."""
    bus, drives = BusSettings(**bus_section(a)), DriveSettings(**drives_section(a, rate_Hz))
    try:
        bus_budget(bus, drives, SensorSettings(), rate_Hz)
    except ConfigurationError as error:
        return str(error)
    return None


def enough_channels(a: dict[str, Any], rate_Hz: float) -> str | None:
    """Return the least number of buses, beyond those of the answers, that carries a rate; None: none does."""
    more = [n for n in CHANNELS if int(n) > int(a["channels"])]
    return next((n for n in more if rate_trouble(a | {"channels": n}, rate_Hz) is None), None)


def wn_rad_s(rate_Hz: float) -> float:
    """Return the frequency at whose crossover the delay of the loop costs `PHASE_deg`.

    Delay: one period to the drives, half a period of hold, the drives' lag.
    """
    delay_s = 1.5 / rate_Hz + 1.0 / (2.0 * pi * LAG_Hz)
    return lowered(np.deg2rad(PHASE_deg) / (CROSSOVER * delay_s))


def controller_section(a: dict[str, Any], wn: float) -> dict[str, Any]:
    """Return section `controller`: exact inverse dynamics with error dynamics of `wn`.

    Its gains are frequencies, which follow from the loop's delay alone, and hold in every pose; those of a PD
    are masses of the legs, which differ from pose to pose and motion to motion.
    """
    m = a["reflected_mass_kg"]
    model = {"variant": "full"} | ({"reflected_mass_kg": m} if m else {})
    return {"law": "inverse_dynamics", "wn_rad_s": wn, "damping_ratio": 1.0, "model": model}


def reference_section(a: dict[str, Any], home: AtHome) -> dict[str, Any]:
    """Return a path of an hour at most about home that every leg follows within `EXCURSION` of its stroke.

    The fastest leg uses a quarter of the drives' speed at most, and up to a half while a slow path fades out;
    the hardest accelerates by 1 m/s^2 and by a tenth of the force that holding leaves.
    """
    r = a["platform_radius_m"]
    directions = np.abs(home.J[:, [0, 2, 4]]) * [1.0, 1.0, 1.0 / r]
    free_N = a["drive_force_N"] - float(np.abs(home.static_N).max())
    speed, acceleration = 0.25 * a["drive_speed_m_s"], min(1.0, 0.1 * free_N / home.leg_mass_kg)
    slowest = 2 * pi * SLOWEST_Hz
    excursion = min(EXCURSION * a["stroke_m"], speed / slowest, acceleration / slowest**2)
    amplitude = excursion / float(directions.sum(axis=1).max())
    f = lowered(min(0.5, speed / (2 * pi * excursion), np.sqrt(acceleration / excursion) / (2 * pi)))
    x = lowered(amplitude)
    return {
        "type": "sinusoids",
        "duration_s": max(10.0, ceil(3.0 / f)),
        "ramp_s": max(2.0, rounded(FADE / f)),
        "components": [
            {"axis": "z_m", "amplitude": x, "frequency_Hz": f},
            {"axis": "x_m", "amplitude": x, "frequency_Hz": rounded(0.5 * f)},
            {
                "axis": "ry_deg",
                "amplitude": lowered(np.rad2deg(amplitude / r)),
                "frequency_Hz": rounded(0.7 * f),
            },
        ],
    }


def walked(a: dict[str, Any], reference: dict[str, Any], rate_Hz: float) -> Walk:
    """Return lengths, rates and forces along the path."""
    settings = PlatformSettings.model_validate(platform_section(a))
    path = build_trajectory(
        TypeAdapter(SinusoidReference).validate_python(reference), settings.home, Path(), 1.0 / rate_Hz
    )
    home = robot_at_home(a)
    return walk(home.platform, home.model, path, span_s(path), 1.0 / rate_Hz)


def steps(a: dict[str, Any], rate_Hz: float) -> tuple[float, float]:
    """Return by how much the steps of encoder and frames put a length off, m, and its rate, m/s."""
    bus, drives = BusSettings(**bus_section(a)), DriveSettings(**drives_section(a, rate_Hz))
    read = build_protocol(bus, drives).traits.resolution.at(rate_Hz)
    return max(float(read.length.max()), float(a["encoder_resolution_m"])), float(read.rate.max())


def monitor_section(a: dict[str, Any], rate_Hz: float) -> dict[str, Any]:
    """Return section `monitor`: a reading that is cut is off by its step, and one may be off by more."""
    length, rate = steps(a, rate_Hz)
    least = raised(1.5 * rate) if rate else 0.0
    coarse = {"rate_noise_m_s": least} if least > MonitorSettings().rate_noise_m_s else {}
    return {"length_noise_m": rounded(2.0 * length)} | coarse


def limits_section(
    a: dict[str, Any], home: AtHome, w: Walk, approach_m_s: float, rate_Hz: float
) -> dict[str, Any]:
    """Return section `limits`: what path and approach need, with room, never above what the drives have."""
    peak, held = float(np.abs(w.tau).max()), float(np.abs(home.static_N).max())
    force = min(a["drive_force_N"], raised(2.5 * peak))
    needed = max(float(np.abs(w.dq).max()), 1.875 * approach_m_s)
    swing = float(window_swing(w.tau, max(1, round(WINDOW_S * rate_Hz))).max())
    free = max(force - held, 0.1 * force)
    return {
        "force_N": force,
        "force_step_N": raised(0.2 * force),
        "force_window_N": raised(max(force, 2.0 * swing)),
        "speed_m_s": min(a["drive_speed_m_s"], raised(2.5 * needed)),
        "deceleration_m_s2": lowered(0.5 * free / home.leg_mass_kg),
        "stroke_margin_m": rounded(0.02 * a["stroke_m"]),
        "following_error_m": following_error_m(a),
        "following_error_s": 0.02,
        "standstill_m": raised(max(min(5e-4, 0.01 * a["stroke_m"]), 4 * steps(a, rate_Hz)[0]), 3),
    }


def operator_section(a: dict[str, Any], speed_m_s: float) -> dict[str, Any]:
    """Return the speeds of set-up: the usual ones, or less, so that a leg keeps to 0.8 of its speed limit."""
    usual, room = OperatorSettings(), 0.8 * speed_m_s
    return {
        "setup_speed_m_s": min(usual.setup_speed_m_s, lowered(room)),
        "setup_speed_deg_s": min(usual.setup_speed_deg_s, lowered(degrees(room / a["platform_radius_m"]))),
    }


def following_error_m(a: dict[str, Any]) -> float:
    """Return what a leg may be off its reference at rest, m: 2 % of the stroke."""
    return rounded(0.02 * a["stroke_m"])


def closing_s(a: dict[str, Any], home: AtHome, speed_m_s: float) -> float:
    """Return how long a brake may take until the fastest leg rests on it, s: t + m v / (brake - weight)."""
    spare_N = max(a["brake_force_N"] - float(np.abs(home.static_N).max()), 0.05 * a["brake_force_N"])
    return raised(1.2 * (1e-3 * a["brake_ms"] + home.leg_mass_kg * speed_m_s / spare_N))


def step_us(rate_Hz: float, key: str, longest_us: float) -> dict[str, Decimal]:
    """Return the plant's step under its key, where the default `longest_us` does not divide the period.

    To twelve digits: a period is a whole number of steps to 1e-9.
    """
    period_us = 1e6 / rate_Hz
    steps = ceil(period_us / longest_us - 1e-9)
    whole = abs(period_us - steps * longest_us) <= 1e-9 * period_us
    return {} if whole else {key: Decimal(f"{period_us / steps:.12g}")}


def plant_section(a: dict[str, Any], home: AtHome) -> dict[str, Any]:
    """Return the plant with our FMU, and what the emulated drives add."""
    w_hold = 2.0 * pi * HOLD_Hz
    return {
        "model": {
            "type": "stewart",
            "force_bandwidth_Hz": LAG_Hz,
            "reflected_mass_kg": a["reflected_mass_kg"],
            "brake_force_N": a["brake_force_N"],
            **step_us(a["rate_Hz"], "internal_step_us", 100.0),
        },
        "drives": {
            "encoder_resolution_m": 0.0 if counts_itself(a) else a["encoder_resolution_m"],
            "damping_N_s_m": rounded(2.0 * home.leg_mass_kg * w_hold),
            "hold_stiffness_N_m": rounded(home.leg_mass_kg * w_hold**2),
            "brake_open_ms": a["brake_ms"],
            "brake_close_ms": a["brake_ms"],
        },
    }
