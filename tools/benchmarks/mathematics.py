"""Forward kinematics and exact inverse dynamics: the kernels, plain NumPy, and MuJoCo where installed."""

from __future__ import annotations

import time
from importlib.util import find_spec

import numpy as np

from drivers.arrays import Array
from hil.app.compose import build_cycle
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.estimation.pose import Estimator
from hil.loop.reference import complete
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.signals import Reference, State
from tools.benchmarks.bench import Bench
from tools.benchmarks.figures import Figure, Mark, spread
from tools.benchmarks.plain import PlainPose, PlainRobot, forward_kinematics, joint_inverse_dynamics

FAST = Mark(15.0, of=("median",))
"""us, one tick of mathematics."""
AHEAD = Mark(15.0, at_most=False)
"""Times as fast as NumPy."""
TICKS = 2000
"""One period of the path at 1 kHz."""
_now = time.perf_counter_ns


def mathematics(bench: Bench) -> list[Figure]:
    """Follow one period of the path, tick by tick, with each of them."""
    bench.say("kernels and plain NumPy along one period of the path")
    c = bench.configuration
    parts = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts
    law = parts.law
    assert isinstance(law, JointInverseDynamics)
    path = [complete(parts.platform, parts.trajectory.sample(k / c.loop.rate_Hz)) for k in range(TICKS)]
    kernels, tau = _kernels(law, path)
    arrays, expected = _plain(law, path)
    difference = float(np.abs(tau - expected).max() / np.abs(expected).max())
    figures = []
    for column, name in enumerate(("forward kinematics, twist", "inverse dynamics", "both")):
        ours, theirs = kernels[:, column], arrays[:, column]
        whole = name == "both"
        ratio = float(np.median(theirs) / np.median(ours))
        figures += [
            Figure(name, spread(ours), "us", FAST if whole else None),
            Figure("  in plain NumPy", spread(theirs), "us"),
            Figure("  NumPy / kernel, medians", {"": ratio}, "times", AHEAD if whole else None),
        ]
    figures.append(Figure("  largest difference of tau", {"": difference}, "of the peak force"))
    return figures + _mujoco(law.model, path)


def _kernels(law: JointInverseDynamics, path: list[Reference]) -> tuple[Array, Array]:
    """Return times (n, 3) ns and tau (n, 6) of what the loop calls."""
    estimator = Estimator(law.model.platform, path[0].p, path[0].R)
    times = np.zeros((len(path), 3))
    tau = np.zeros((len(path), 6))
    for k, r in enumerate(path):
        begun = _now()
        found = estimator.update(r.q, r.dq)
        located = _now()
        state = State(r.q, r.dq, found.p, found.R, found.twist, found.J, found.iterations, found.residual)
        ready = _now()
        tau[k] = law.effort(state, r, np.zeros(6)).tau
        done = _now()
        times[k] = located - begun, done - ready, done - begun
    return times, tau


def _plain(law: JointInverseDynamics, path: list[Reference]) -> tuple[Array, Array]:
    """Return the same of the NumPy version."""
    robot = PlainRobot.of(law.model.platform)
    pose = PlainPose(path[0].p, path[0].R, path[0].twist, np.zeros((6, 6)))
    times = np.zeros((len(path), 3))
    tau = np.zeros((len(path), 6))
    for k, r in enumerate(path):
        begun = _now()
        pose = forward_kinematics(robot, r.q, r.dq, pose.p, pose.R)
        located = _now()
        ddq = r.ddq + law.K_D * (r.dq - r.dq) + law.K_P * (r.q - r.q)
        tau[k] = joint_inverse_dynamics(robot, pose, ddq)
        done = _now()
        times[k] = located - begun, done - located, done - begun
    return times, tau


def _mujoco(model: Model, path: list[Reference]) -> list[Figure]:
    """Compare with MuJoCo's inverse dynamics: pose, twist and acceleration given, no forward kinematics."""
    try:
        from tools.benchmarks.mujoco_model import MujocoRobot  # noqa: PLC0415 - needs the extra
    except ImportError as error:
        why = str(error).splitlines()[0] if find_spec("mujoco") else "not installed (extra `bench`)"
        return [Figure("MuJoCo's inverse dynamics", note=why)]

    robot = MujocoRobot(model.platform, path[0].p, path[0].R)
    times = np.zeros((len(path), 2))
    worst = peak = 0.0
    nothing = np.zeros(6)
    for k, r in enumerate(path):
        begun = _now()
        tau = inverse_dynamics_kernel(model.constants, model.code, r.p, r.R, r.twist, r.dtwist, nothing)
        times[k, 0] = _now() - begun
        robot.place(r.p, r.R, r.twist, r.dtwist)
        begun = _now()
        robot.inverse()
        times[k, 1] = _now() - begun
        worst = max(worst, float(np.abs(robot.leg_forces() - tau).max()))
        peak = max(peak, float(np.abs(tau).max()))
    ours, theirs = times.T
    return [
        Figure("inverse dynamics of a given pose", spread(ours), "us"),
        Figure("  mj_inverse, legs cut at the platform", spread(theirs), "us", note="without closing them"),
        Figure("  MuJoCo / kernel, medians", {"": float(np.median(theirs) / np.median(ours))}, "times"),
        Figure("  largest difference of tau", {"": worst / peak}, "of the peak force"),
    ]
