"""An encoder that fails: who notices, when, by the plant's own lengths, and what must not alarm."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.signals import Doubt, Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.sim.lockstep import Lockstep
from hil.loop.run_end import Ending
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.kinds import BrakeStuckClosed, EncoderFreeze, EncoderJump, FramesLoss, WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad

BOUND_m = 2e-3
BOUND_TICKS = 20
"""A failure is found within one of the two."""
MOVED_m = 1e-4
"""True motion from which a frozen encoder is counted."""
POWERED = (
    Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING,
)  # fmt: skip
STOP_S = {"virtual": 2.5, "lab": 4.5}
"""When the runs are stopped: in mid-motion."""
PUSH_N = {"virtual": 3000.0, "lab": 600.0}
"""On a platform at hold; on `lab`, ten times the friction of a leg."""


class Ran(NamedTuple):
    ending: Ending
    rows: Any
    true: Any
    """(n, 6) m, the plant's own lengths at each tick."""

    def begins(self, mode: Mode, share: float = 0.37) -> float:
        """Return a time within a mode, s."""
        ticks = np.flatnonzero(self.rows["mode"] == mode)
        return float(1e-3 * (ticks[0] + round(share * len(ticks))))


def run(c: Configuration, *faults: PlantFault, stop_s: float | None = None, seed: int = 0) -> Ran:
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(c, FaultPlan(faults, seed))
    timing = None if c.bus.layout == "ideal" else BitTiming.of(c.bus)
    rows: list[Any] = []
    true: list[Any] = []

    def observe(_inp: object, _opening: object, out: Any) -> None:
        rows.append(out.row)
        true.append(nodes.snapshot().length)

    try:
        ending = Lockstep(cycle, nodes, (timing,), c.loop.window_s(rate)).run(stop_s, observe)
    finally:
        plant.close()
    return Ran(ending, np.array(rows, rows[0].dtype), np.array(true))


def at_hold(name: str) -> Configuration:
    """Return a shipped configuration whose reference stays at home."""
    c = load(name)
    home = list(c.platform.home.position_m)
    points = "".join(f"    - {{t_s: {t}, position_m: {home}}}\n" for t in (0, 60))
    held = f"reference:\n  type: waypoints\n  interpolation: quintic\n  periods: 1\n  points:\n{points}\n"
    return loads(re.sub(r"(?ms)^reference:.*?(?=^\S)", held, c.text), c.name, c.folder)


@pytest.fixture(scope="module", params=["virtual", "lab"])
def good(request: pytest.FixtureRequest) -> tuple[str, Ran]:
    ran = run(load(request.param), stop_s=STOP_S[request.param])
    assert ran.ending.success, ran.ending
    return request.param, ran


def found(ran: Ran, leg: int) -> int:
    """Return the tick of the fault, which names the leg and nothing else."""
    tick = int(np.argmax(ran.rows["faults"] != 0))
    row = ran.rows[tick]
    assert row["faults"] & Fault.ENCODER, ran.ending
    assert row["legs_doubted"] == 1 << leg
    assert ran.ending.mode in {Mode.FAULT, Mode.HELD}
    assert f"leg {leg} " in ran.ending.reason
    return tick


def assert_in_time(ran: Ran, leg: int, since: int) -> None:
    """Assert that the fault came within the bounds of the leg's first true motion after a tick."""
    tick = found(ran, leg)
    moved = np.abs(ran.true[:, leg] - ran.true[since, leg])
    begins = since + int(np.argmax(moved[since:] > MOVED_m))
    late = tick - begins
    assert late <= BOUND_TICKS or moved[: tick + 1][since:].max() <= BOUND_m, f"{late} ticks, {moved[tick]} m"


JUMPS = [(0, 0.5e-3), (3, -9.5e-3)]
"""In turn from mode to mode."""
EVERY_JUMP = [
    pytest.param(mode, leg, by, marks=pytest.mark.long)
    for mode in POWERED
    for leg in range(6)
    for by in (0.5e-3, -0.5e-3, 1e-3, -5e-3, 9.5e-3, -9.5e-3)
]


@pytest.mark.parametrize(
    ("mode", "leg", "by"), [*((mode, *JUMPS[n % 2]) for n, mode in enumerate(POWERED)), *EVERY_JUMP]
)
def test_a_jump_is_found_in_its_tick_in_every_mode(good, mode, leg, by):
    """Before: never, as six lengths always fit some pose."""
    name, ran = good
    at = ran.begins(mode)
    jumped = run(load(name), EncoderJump(leg=leg, by_m=by, at_s=at), stop_s=STOP_S[name])
    assert found(jumped, leg) - round(1e3 * at) <= 1
    assert jumped.rows["doubt"][-1] == Doubt.JUMP
    assert jumped.rows["doubt_value"][-1] == pytest.approx(by, abs=2e-6)
    said = np.bitwise_or.reduce(jumped.rows["faults"])
    assert not said & Fault.BRAKE, "a length that jumped is no motion"


@pytest.mark.parametrize("leg", [2, *(pytest.param(leg, marks=pytest.mark.long) for leg in range(6))])
@pytest.mark.parametrize("mode", [Mode.RELEASING, Mode.TRACKING, Mode.STOPPING])
def test_a_frozen_encoder_is_found_in_motion_and_when_motion_begins(good, mode, leg):
    name, ran = good
    at = ran.begins(mode)
    frozen = run(load(name), EncoderFreeze(leg=leg, at_s=at), stop_s=STOP_S[name])
    assert_in_time(frozen, leg, round(1e3 * at))


PUSHES = [(0, 0, -1), (1, 0, 0), (0, 1, 0)]


@pytest.mark.parametrize("leg", [1, *(pytest.param(leg, marks=pytest.mark.long) for leg in range(6))])
@pytest.mark.parametrize(
    "along", [PUSHES[0], PUSHES[2], *(pytest.param(p, marks=pytest.mark.long) for p in PUSHES[:2])]
)
@pytest.mark.parametrize("name", ["virtual", "lab"])
def test_a_frozen_encoder_at_hold_is_found_when_a_load_moves_the_platform(name, along, leg):
    """Before: after 600 ms and 373 mm. On `lab` friction may hold a leg still as well: a push decides."""
    fx, fy, fz = (PUSH_N[name] * x for x in along)
    frozen = run(
        at_hold(name),
        EncoderFreeze(leg=leg, at_s=2.6),
        WrenchStep(force_N=(fx, fy, fz), moment_N_m=(0.0, 0.0, 0.0), at_s=2.8),
        stop_s=4.0,
    )
    assert_in_time(frozen, leg, 2800)
    assert frozen.rows["doubt"][-1] == Doubt.STILL
    assert "frozen, or its brake did not open or has closed" in frozen.ending.reason


@pytest.mark.parametrize("leg", [0, *(pytest.param(leg, marks=pytest.mark.long) for leg in range(1, 6))])
@pytest.mark.parametrize("name", broad(["lab", "virtual"], quick=1))
def test_a_brake_that_does_not_open_is_found_before_a_leg_has_moved_by_10_mm(name, leg):
    shut = run(load(name), BrakeStuckClosed(leg=leg), stop_s=STOP_S[name])
    found(shut, leg)
    assert np.abs(shut.true - shut.true[0]).max() < 10e-3


@pytest.mark.parametrize("leg", [0, *(pytest.param(leg, marks=pytest.mark.long) for leg in range(1, 6))])
def test_a_frozen_encoder_without_a_load_is_found_when_the_leg_drifts_away(leg):
    """Nothing controls that leg: it leaves its place slowly, and moves the others by a few per cent of that."""
    frozen = run(at_hold("virtual"), EncoderFreeze(leg=leg, at_s=2.0), stop_s=6.0)
    assert_in_time(frozen, leg, 2000)


def test_an_encoder_that_freezes_on_closed_brakes_is_not_observable_and_leaves_no_error(good):
    name, ran = good
    frozen = run(load(name), EncoderFreeze(leg=4, at_s=ran.begins(Mode.UNLOADING)), stop_s=STOP_S[name])
    assert frozen.ending.success
    assert np.abs(frozen.true[-1] - ran.true[-1]).max() < MOVED_m


def loads_up_to(c: Configuration, seed: int, end_s: float) -> list[WrenchStep]:
    """Return short wrench steps, the largest acceleration of a leg at home being the stated disturbance."""
    generator = np.random.default_rng(seed)
    platform = build_platform(c.platform)
    home = pose_arrays(c.platform.home)
    J = jacobian(platform, *home)
    legs = J @ np.linalg.inv(Model(platform, leg_spin=c.platform.leg_spin).mass_matrix(*home))
    steps, t = [], 1.0
    while t < end_s:
        w = J.T @ generator.standard_normal(6)
        if generator.random() < 0.5:  # along one axis
            w = np.eye(6)[generator.integers(6)] * generator.choice([-1.0, 1.0])
        w *= c.monitor.disturbance_m_s2 / np.abs(legs @ w).max()
        for_s = generator.uniform(4e-3, 20e-3)
        steps.append(WrenchStep(force_N=w[:3].tolist(), moment_N_m=w[3:].tolist(), at_s=t, for_s=for_s))
        t += for_s + generator.uniform(0.05, 0.3)
    return steps


@pytest.mark.parametrize("lost", broad([0.03, 0.0], quick=1))
@pytest.mark.parametrize(
    ("name", "still"),
    broad([("lab", True), ("virtual", False), ("lab", False), ("virtual", True)], quick=1),
)
@pytest.mark.parametrize(
    ("seed", "stop_s"),
    [(0, 5.0), *(pytest.param(seed, 60.0, marks=pytest.mark.long) for seed in range(1, 11))],
)
def test_loads_up_to_the_stated_disturbance_and_lost_frames_alarm_nobody(name, still, lost, seed, stop_s):
    c = at_hold(name) if still else load(name)
    faults: list[PlantFault] = [*loads_up_to(c, seed, stop_s)]
    if lost:
        faults.append(FramesLoss(probability=lost, at_s=1.0))
    ran = run(c, *faults, stop_s=stop_s, seed=seed)
    assert not ran.rows["legs_doubted"].any(), ran.ending
    assert lost or ran.ending.success, ran.ending


@pytest.mark.parametrize("name", broad(["ideal", "vcan50", "bench"], quick=2))
def test_the_other_shipped_configurations_alarm_nobody(name):
    ran = run(load(name), stop_s=5.0)
    assert ran.ending.success, ran.ending
    assert not ran.rows["legs_doubted"].any()
