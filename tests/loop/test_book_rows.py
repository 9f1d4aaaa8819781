"""Every row of the book's closed loops: each law on the ideal path, compared field by field.

Expected errors: tests/data/book_closed_loop.json, simulated independently from the book's parameters. Both
ends run in lockstep over the ideal bus; a row in continuous time is run at 10 kHz. Two rows contain rounding
errors only, which no zero-order hold can reach: their law is integrated with the accelerations of the plant's
FMU.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from scipy.spatial.transform import Rotation

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import Callee, of_python
from drivers.signals import Fault, Mode, Warn
from drivers.tick_columns import tick_at
from hil.app.check.command import inspect
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, platform_dict, pose_arrays
from hil.app.sim.build import build_lockstep
from hil.contracts.records import asked, referred
from hil.control.law import LawContext
from hil.loop.cycle import Cycle
from hil.loop.run_end import Course
from hil.robot.kinematics import jacobian, leg_lengths
from hil.safety.encoder_limits import NONE
from hil.trajectory.build import build_trajectory
from plant_fmu.faults.kinds import WrenchStep
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Robot
from plant_fmu.stewart.build import build
from plant_fmu.stewart.plant import stewart_parameters
from tests.broad import broad
from tests.loop.bench import changed, new_cycle

ROWS = json.loads((Path(__file__).parents[1] / "data" / "book_closed_loop.json").read_text())["rows"]
LOADED = "joint_FF_PD_exact_10kN_step_xyz_from_0.5s_1kHz_ZOH"
TASK = "task_PD_ch5_g9.8"
CONSTANT = "joint_IDC_const_home_dynamics_wn20"
LIMITS = Warn.FORCE_LIMIT | Warn.FORCE_STEP | Warn.FORCE_WINDOW

GAINS = {"kp_N_m": 2.0e6, "kv_N_s_m": 5.0e4}
PD: dict[str, Any] = {"law": "pd", **GAINS}
FF_PD: dict[str, Any] = {"law": "feedforward_pd", **GAINS}
TASK_PD: dict[str, Any] = {
    "law": "cartesian_pd", "kp_position_N_m": 1.0e6, "kv_position_N_s_m": 1.0e5,
    "kp_rotation_N_m_rad": 1.0e7, "kv_rotation_N_m_s_rad": 1.0e5,
}  # fmt: skip


def idc(wn: float, variant: str = "full") -> dict[str, Any]:
    frozen = {"frozen_at": {"position_m": [0, 0, 1]}} if variant.startswith("constant") else {}
    return {"law": "inverse_dynamics", "wn_rad_s": wn, "model": {"variant": variant} | frozen}


AXES = [
    ("x_m", 0.05, 0), ("y_m", 0.05, 1), ("z_m", 0.1, 2), ("rx_deg", 5, 0.5), ("ry_deg", 5, 1.5), ("rz_deg", 3, 2.5)
]  # fmt: skip
SMALL_MOTION = {
    "type": "sinusoids",
    "ramp_s": 1,
    "duration_s": 5,
    "components": [{"axis": a, "amplitude": by, "frequency_Hz": 1, "phase_rad": at} for a, by, at in AXES],
}
"""Motion from the note in the data file; it fades out in the fifth second, which is not compared."""


def ideal(
    law: dict[str, Any], *, rate_Hz: int = 1000, small: bool = False, gravity: float = 9.81
) -> Configuration:
    """The ideal bench under a given law."""
    sections = {"reference": SMALL_MOTION} if small else {}
    gravity_m_s2 = {"gravity_m_s2": [0, 0, -gravity]}
    return changed("ideal", controller=law, loop={"rate_Hz": rate_Hz}, platform=gravity_m_s2, **sections)


def track(configuration, seconds, *faults, prepare=None):
    """Run both ends in lockstep until `seconds` of the reference are tracked, or a fault; return those rows.

    prepare(cycle, plant) changes parts before the first tick, or returns another cycle.
    """
    rate = configuration.loop.rate_Hz
    cycle = new_cycle(configuration)
    nodes, plant = build_nodes(configuration, FaultPlan(faults))
    rows: list[np.ndarray] = []
    try:
        if prepare is not None:
            cycle = prepare(cycle, plant) or cycle
        lockstep, course = build_lockstep(configuration, cycle, nodes), Course(cycle)
        while len(rows) < round(seconds * rate):
            row = lockstep.step(course.commands(lockstep.tick + 1))[2].row
            if cycle.mode is Mode.TRACKING or cycle.faults:
                rows.append(row)
            if cycle.faults:
                break
            assert lockstep.tick < 10 * rate, cycle.mode
    finally:
        plant.close()
    return np.array(rows, rows[0].dtype)


def figures_of(p, R, p_d, R_d, q, q_d, tau):
    """The fields of the data file: errors are reference minus actual, rotations log(R_d R^T) in the base
    frame.
    """
    e = 1e3 * (p_d - p)
    r = np.degrees(Rotation.from_matrix(R_d @ R.transpose(0, 2, 1)).as_rotvec())
    l = 1e3 * (q_d - q)
    return {
        "peak_pos_mm": np.abs(e).max(axis=0),
        "peak_rot_deg": np.abs(r).max(axis=0),
        "rms_pos_mm": np.sqrt((e**2).mean(axis=0)),
        "rms_rot_deg": np.sqrt((r**2).mean(axis=0)),
        "peak_leg_err_mm": np.abs(l).max(),
        "rms_leg_err_mm": np.sqrt((l**2).mean()),
        "peak_leg_force_N": np.abs(tau).max(),
        "final_pos_mm": e[-1],
        "final_rot_deg": r[-1],
    }


def figures(rows):
    assert (rows["mode"] == Mode.TRACKING).all()
    assert not np.bitwise_or.reduce(rows["warnings"]) & LIMITS, "theory must not be clipped"
    R, R_d = (rows[name].reshape(-1, 3, 3) for name in ("R", "R_d"))
    return figures_of(rows["p"], R, rows["p_d"], R_d, rows["q"], rows["q_d"], rows["tau"])


def deviations(found, row):
    """Relative deviations from a row of the data file, the worst component of each field; finals relative to
    peaks.
    """
    worst = {}
    for field, expected in ROWS[row].items():
        scale = np.abs(ROWS[row][field.replace("final", "peak")])
        worst[field] = float(np.max(np.abs(found[field] - np.asarray(expected)) / scale))
    return worst


# -- at 1 kHz ------------------------------------------------------------------------------------------------

HELD = {
    "joint_PD_ch6_1kHz_ZOH": (PD, False),
    "joint_FF_PD_exact_model_1kHz_ZOH": (FF_PD, False),
    "joint_IDC_exact_wn20_1kHz_ZOH": (idc(20), False),
    "joint_IDC_partial_wn20_1kHz_ZOH": (idc(20, "printed"), False),
    "small_motion_1Hz_PD_only": (PD, True),
    "small_motion_1Hz_FF_PD_exact": (FF_PD, True),
    "small_motion_1Hz_IDC_exact_wn20": (idc(20), True),
    "small_motion_1Hz_IDC_constant_home_wn20": (idc(20, "constant"), True),
    "small_motion_1Hz_IDC_constant_home_wn60": (idc(60, "constant"), True),
}


@pytest.mark.parametrize("row", broad(HELD, quick=4))
def test_published_simulation_results_at_1_kHz_are_reproduced_in_every_field(row):
    law, small = HELD[row]
    found = figures(track(ideal(law, small=small), 4.0 if small else 2.0))
    worst = deviations(found, row)
    assert max(worst.values()) < 1e-3, worst
    if row == "small_motion_1Hz_IDC_constant_home_wn60":
        assert found["peak_leg_err_mm"] == pytest.approx(1.67, rel=0.10)
        assert found["peak_pos_mm"].max() <= 0.7


def test_published_result_with_a_load_step_of_10_kN_at_half_a_second_is_reproduced():
    """10 kN along x, y and z at the platform's origin, unknown to feed-forward and PD."""
    first_tick_s = 0.009
    step = WrenchStep(at_s=first_tick_s + 0.5, force_N=(1e4, 1e4, 1e4), moment_N_m=(0.0, 0.0, 0.0))
    rows = track(ideal(FF_PD), 2.0, step)
    assert rows["t_ns"][0] == round(first_tick_s * 1e9), "the load is timed from the drives' start"
    worst = deviations(figures(rows), LOADED)
    assert max(worst.values()) < 1e-3, worst


# -- in continuous time, at 10 kHz ----------------------------------------------------------------------------


G_98 = 9.8
CONTINUOUS: dict[str, tuple[dict[str, Any], float]] = {
    "joint_PD_ch6": (PD, 9.81),
    "joint_FF_PD_masses_90pct": (FF_PD | {"model": {"inertia_scale": 0.9}}, 9.81),
    "joint_IDC_partial(noH,noJdot)_wn20": (idc(20, "printed"), 9.81),
    TASK: (TASK_PD | {"rotation_error": "vector_difference"}, G_98),
}


@pytest.mark.long
@pytest.mark.parametrize("row", CONTINUOUS)
def test_published_continuous_time_results_are_reproduced_at_10_kHz_in_every_field(row):
    law, gravity = CONTINUOUS[row]
    worst = deviations(figures(track(ideal(law, rate_Hz=10_000, gravity=gravity), 2.0)), row)
    assert max(worst.values()) < 0.01, worst


# -- constant dynamics through a singularity -------------------------------------------------------------------


BOUNDLESS = (
    *("consistency_m", "condition", "length_max_m", "deceleration_m_s2", "speed_m_s", "following_error_m"),
    *("standstill_m", "force_N", "force_step_N", "force_window_N"),
)
"""Limits to disable so that safety passes every force and never faults."""


class Follow:
    """A filter that reports the true pose, even through the singularity."""

    def __init__(self, platform, plant):
        self.platform, self.plant = platform, plant
        self.record = {"R": np.eye(3)}
        address, keeps = of_python(self._estimate, *[INTEGER] * 5)
        self.fuse = Callee(address, 0, keeps)

    def begin(self, tick):
        pass

    def _estimate(self, _context, _sensors, _command, _wrench, at):
        tick, truth = tick_at(at), self.plant.truth()
        tick["p"], tick["R"], tick["twist"] = truth.p, truth.R, truth.twist
        tick["J"] = jacobian(self.platform, truth.p, truth.R)
        tick["fk_residual"] = np.abs(leg_lengths(self.platform, truth.p, truth.R) - tick["q"]).max()
        tick["condition"] = 1.0
        return 0


def let_pass_and_follow(cycle, plant):
    limits = cycle.parts.safety.limits
    for name, value in NONE._asdict().items():
        limits[name] = value
    for name in BOUNDLESS:
        limits[name] = np.inf
    limits["length_min_m"], limits["stroke_margin_m"] = -np.inf, 0.0
    return Cycle(replace(cycle.parts, fusion=Follow(cycle.parts.platform, plant)))


@pytest.mark.long
def test_constant_inverse_dynamics_without_safety_end_in_the_published_assembly_mode():
    rows = track(ideal(idc(20, "constant"), rate_Hz=10_000), 2.0, prepare=let_pass_and_follow)
    worst = deviations(figures(rows), CONSTANT)
    assert max(worst.values()) < 0.01, worst


def test_constant_inverse_dynamics_cause_a_fault_before_the_singularity_at_1_011_s():
    """The row's motion crosses the singularity at 1.011 s."""
    configuration = ideal(idc(20, "constant"))
    rows = track(configuration, 2.0)
    assert rows["mode"][-1] == Mode.HELD, "the configuration has no brake test that could prove the brakes"
    assert rows["reference_time_s"][-2] < 1.011
    assert int(rows["faults"][-1]) & (Fault.CONDITION | Fault.KINEMATICS | Fault.ASSEMBLY)
    assert any("small motion only" in w for w in inspect(configuration).warnings)


# -- rounding: the law integrated with the accelerations of the plant's FMU -------------------------------------


class Accelerations:
    """The plant's FMU as a function: from pose, twist and leg forces to the platform's acceleration."""

    def __init__(self, configuration, folder):
        path = build("3.0")
        fmpy.extract(str(path), str(folder))
        description = fmpy.read_model_description(str(path))
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = FMU3Slave(
            guid=description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="accelerations",
        )
        self.fmu.instantiate()
        c = configuration
        p, R = pose_arrays(c.platform.home)
        ends = np.full(6, c.platform.length_min_m), np.full(6, c.platform.length_max_m)
        given = stewart_parameters(c.plant.model, Robot(platform_dict(c.platform), *ends, p, R))
        self.parameters = {k: v for k, v in given.items() if k != "leg_spin"}

    def __call__(self, p, R, twist, tau):
        fmu = self.fmu
        fmu.reset()
        start = {"initial_position": p, "initial_rotation": R, "initial_twist": twist}
        for name, value in (self.parameters | start).items():
            fmu.setFloat64([self.reference[name]], np.ravel(value).tolist())
        fmu.enterInitializationMode()
        fmu.setFloat64([self.reference["force"]], tau.tolist())
        fmu.setFloat64([self.reference["brake"]], [0.0] * 6)
        fmu.exitInitializationMode()
        return np.array(fmu.getFloat64([self.reference["acceleration"]], 6))


def integrate(configuration, law, accelerations, dt=2e-3, seconds=2.0):
    """Integrate p, twist and the rotation vector of each step with fourth-order Runge-Kutta; return the
    fields.
    """
    platform = build_platform(configuration.platform)
    trajectory = build_trajectory(configuration.reference, configuration.platform.home, Path())
    p, R = pose_arrays(configuration.platform.home)
    twist = np.zeros(6)
    seen = []

    def slope(t, x, R):
        """Time derivative of [p, r, twist] with R(r) = exp([r]x) R; its error is of fifth order in r."""
        r, twist = x[3:6], x[6:]
        here = np.ascontiguousarray(Rotation.from_rotvec(r).as_matrix() @ R)
        J = jacobian(platform, x[:3], here)
        q = leg_lengths(platform, x[:3], here)
        state = {"q": q, "dq": J @ twist, "p": x[:3], "R": here, "twist": twist, "J": J}
        tick = referred(platform, trajectory.sample(t), **state)
        tau = asked(law, tick)
        w = twist[3:]
        dr = w - np.cross(r, w) / 2 + np.cross(r, np.cross(r, w)) / 12
        now = *(tick[name] for name in ("p", "R", "p_d", "R_d", "q", "q_d")), tau
        return np.concatenate([twist[:3], dr, accelerations(x[:3], here, twist, tau)]), now

    steps = round(seconds / dt)
    for k in range(steps + 1):
        t, x = k * dt, np.concatenate([p, np.zeros(3), twist])
        k1, now = slope(t, x, R)
        seen.append(now)
        if k == steps:
            break
        k2, _ = slope(t + dt / 2, x + dt / 2 * k1, R)
        k3, _ = slope(t + dt / 2, x + dt / 2 * k2, R)
        k4, _ = slope(t + dt, x + dt * k3, R)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        p, twist = x[:3], x[6:]
        R = np.ascontiguousarray(Rotation.from_rotvec(x[3:6]).as_matrix() @ R)
    return figures_of(*(np.array(column) for column in zip(*seen, strict=True)))


def law_of(configuration):
    platform = build_platform(configuration.platform)
    return configuration.controller.build(LawContext(platform, "none", 1e-3))


ROUNDING = [
    ("joint_FF_PD_exact_model", FF_PD),
    ("joint_IDC_exact_wn20", idc(20)),
    ("joint_IDC_exact_wn20", {"law": "pose_inverse_dynamics", "wn_rad_s": 20}),
]


@pytest.mark.parametrize(("row", "law"), broad(ROUNDING, quick=1))
def test_published_results_without_sample_and_hold_are_reproduced_to_rounding_errors(row, law, tmp_path):
    configuration = ideal(law)
    found = integrate(configuration, law_of(configuration), Accelerations(configuration, tmp_path))
    assert max(found["peak_leg_err_mm"], *found["peak_pos_mm"]) < 1e-4
    assert found["peak_leg_force_N"] == pytest.approx(ROWS[row]["peak_leg_force_N"], rel=1e-6)


def test_every_row_of_the_published_results_has_a_test():
    assert {*HELD, *CONTINUOUS, *(row for row, _ in ROUNDING), LOADED, CONSTANT} == set(ROWS)
