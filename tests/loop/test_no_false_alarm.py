"""Loads up to the stated disturbance, on a machine that stalls now and then: no fault, and no doubted leg."""

from __future__ import annotations

from functools import partial
from math import e
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import configs
from drivers.arrays import Array
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.loop.run_end import Ending
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.path import Trajectory
from plant_fmu.config import StewartPlant
from plant_fmu.faults.kinds import PayloadStep, WrenchStep
from plant_fmu.faults.plan import STANDARD_GRAVITY, FaultPlan
from tests.broad import broad
from tests.loop.bench import new_cycle
from tests.loop.stalling import build_stalling

SHIPPED = sorted(path.stem for path in Path(str(configs.__file__)).parent.glob("*.yaml"))
VIRTUAL = [name for name in SHIPPED if load(name).plant is not None]
FOLLOWS = 0.4
"""Share of the allowed tracking error that a load may cause; the path and friction need the rest."""
ANSWERS = 0.25
"""Share of the allowed change of force that the law may need against a load, anywhere on the path."""


def longest_stall_s(c: Configuration) -> float:
    """Longest stall without a stale feedback and without a watchdog reaction of the drives.

    Three ticks are reserved for the answers to frames sent before and after the stall, one behind the other.
    """
    return min((c.limits.stale_fault_ticks - 3) / c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3 / 3.0)


def follows(c: Configuration, wn: float, at_s: float, for_s: float) -> float:
    """Acceleration of a leg, m/s^2, that keeps it within its tracking error.

    e'' + 2 wn e' + wn^2 e = a peaks at a / wn^2, and after a short a of T s at a T / (wn 2.718). Before the
    law has taken over, a leg moves on at a T.
    """
    engaged_s = 0.1 + c.engage.force_ramp_s + c.engage.brake_release_s + c.engage.blend_s
    peak_s2 = min(1.0 / wn**2, for_s / (wn * e))
    if at_s < engaged_s:
        peak_s2 = for_s * (for_s + engaged_s - at_s)
    return FOLLOWS * c.limits.following_error_m / peak_s2


def loads_of(
    c: Configuration, path: Trajectory, generator: np.random.Generator, end_s: float
) -> list[WrenchStep | PayloadStep]:
    """Steps of any time, direction and size that accelerate a leg at home by at most the stated disturbance.

    A longer step must be smaller: if the law cannot compensate it within its limits, the platform does not
    follow, and that is not a false alarm. The law answers a T at first with 2 wn a T.
    """
    assert isinstance(c.controller, InverseDynamicsSettings)
    wn = float(np.max(c.controller.wn_rad_s))
    platform = build_platform(c.platform)
    home = pose_arrays(c.platform.home)
    J = jacobian(platform, *home)
    legs = J @ np.linalg.inv(Model(platform, leg_spin=c.platform.leg_spin).mass_matrix(*home))
    poses = [path.sample(share * (path.duration_s or 0.0)) for share in np.linspace(0.0, 1.0, 101)]
    forces = [np.linalg.inv(jacobian(platform, pose.p, pose.R).T) for pose in poses]
    steps: list[WrenchStep | PayloadStep] = []
    t = generator.uniform(0.0, 0.3)
    while t < end_s:
        for_s = float(np.exp(generator.uniform(np.log(4e-3), np.log(1.0))))
        load = _unit_load(generator, J)
        a_m_s2 = min(c.monitor.disturbance_m_s2, follows(c, wn, t, for_s))
        force_N = ANSWERS * c.limits.force_window_N / min(1.0, 2.0 * wn * for_s)
        w = _wrench(load)
        size = min(a_m_s2 / np.abs(legs @ w).max(), force_N / max(np.abs(f @ w).max() for f in forces))
        size *= 1.0 if generator.random() < 0.5 else generator.uniform()
        steps.append(_scaled(load, float(size), t, for_s))
        t += for_s + generator.uniform(3.0, 7.0) / wn
    return steps


def _unit_load(generator: np.random.Generator, J: Array) -> WrenchStep | PayloadStep:
    """1 kg somewhere on the platform, or a wrench along an axis, or one equivalent to random leg forces."""
    kind = generator.integers(3)
    if kind == 0:
        x, y = generator.uniform(-0.3, 0.3, 2)
        return PayloadStep(mass_kg=1.0, position_m=(x, y, 0.0))
    w = J.T @ generator.standard_normal(6)
    if kind == 1:
        w = np.eye(6)[generator.integers(6)] * generator.choice([-1.0, 1.0])
    return WrenchStep(force_N=(w[0], w[1], w[2]), moment_N_m=(w[3], w[4], w[5]))


def _wrench(load: WrenchStep | PayloadStep) -> Array:
    """Wrench (6,) N, N m of a load at home, base frame."""
    if isinstance(load, WrenchStep):
        return np.array([*load.force_N, *load.moment_N_m])
    weight = load.mass_kg * np.array(STANDARD_GRAVITY)
    return np.array([*weight, *np.cross(load.position_m, weight)])


def _scaled(
    load: WrenchStep | PayloadStep, size: float, at_s: float, for_s: float
) -> WrenchStep | PayloadStep:
    """The load times `size`, for some time."""
    when: dict[str, Any] = {"at_s": at_s, "for_s": for_s}
    if isinstance(load, WrenchStep):
        w = size * _wrench(load)
        return WrenchStep(force_N=(w[0], w[1], w[2]), moment_N_m=(w[3], w[4], w[5]), **when)
    return PayloadStep(mass_kg=size * load.mass_kg, position_m=load.position_m, **when)


def run(name: str, seed: int, end_s: float | None) -> tuple[Ending, int]:
    """Run a shipped configuration with loads and stalls to its end, or a stop; return the ending and the
    stalls.
    """
    c, generator = load(name), np.random.default_rng([seed, SHIPPED.index(name)])
    rate = c.loop.rate_Hz
    moves = c.plant is not None and isinstance(c.plant.model, StewartPlant)
    cycle = new_cycle(c)
    path = cycle.parts.trajectory
    loads = loads_of(c, path, generator, 60.0 if end_s is None else end_s) if moves else []
    nodes, plant = build_nodes(c, FaultPlan(loads, seed))
    longest_ns = round(1e9 * longest_stall_s(c))
    stalling = build_stalling(
        c, nodes, cycle, generator=generator, every_s=200.0 / rate, longest_ns=longest_ns
    )
    try:
        ending = stalling.run(end_s, partial(assert_calm, name, seed))
    finally:
        plant.close()
    return ending, stalling.stalls


def assert_calm(name: str, seed: int, _inp: object, _opening: object, out: Any) -> None:
    """Assert that a tick has neither a fault nor a doubted leg."""
    row = out.row
    if row["legs_doubted"] or row["faults"]:
        keys = ("tick", "mode", "faults", "legs_doubted", "doubt", "doubt_value", "doubt_limit")
        pytest.fail(f"{name}, seed {seed}: { {key: row[key] for key in keys} }")


WHILES = [
    ("two_buses", 0, 2.5, 5),
    (
        "vcan50",
        7003,
        8.0,
        1,
    ),  # a stall of two periods of 20 ms; the next tick takes 9 ms, and allows less by itself
    ("lab", 0, 5.0, 5),
    ("virtual", 0, 5.0, 5),
    # rates made of lengths: late latches, answers of one tick in the next, and steps of 0.1 ms
    ("virtual-cia402", 1000, 5.0, 5),
    ("lab-cia402", 1000, 13.5, 5),
]


@pytest.mark.parametrize(("name", "seed", "end_s", "least"), broad(WHILES, quick=2))
def test_configured_loads_and_stalls_of_the_machine_raise_no_alarm_in_a_short_run(name, seed, end_s, least):
    ending, stalls = run(name, seed, end_s)
    assert ending.success, ending
    assert stalls > least


@pytest.mark.long
@pytest.mark.parametrize("name", VIRTUAL)
def test_configured_loads_and_stalls_of_the_machine_raise_no_alarm_in_runs_of_two_minutes(name):
    """Runs in sequence, with engaging and parking, for two minutes."""
    ticks, seed = 0, 1000
    while ticks < 120.0 * load(name).loop.rate_Hz:
        ending, _ = run(name, seed, None)
        assert ending.success, f"{name}, seed {seed}: {ending}"
        ticks += ending.ticks
        seed += 1
