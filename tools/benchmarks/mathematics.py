"""Forward kinematics and exact inverse dynamics: the kernels, plain NumPy, and MuJoCo where installed."""

import time
from importlib.util import find_spec

import numpy as np

from drivers.arrays import Array
from drivers.tick_columns import Record, copy_of, new_record
from hil.app.compose import build_cycle
from hil.control.inverse_dynamics import JointInverseDynamics
from hil.estimation.pose import Estimator
from hil.loop.parts import Parts
from hil.loop.reference import fill_reference
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.trajectory.path import PoseSample
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.figures import Figure, Mark, spread
from tools.benchmarks.plain import PlainPose, PlainRobot, forward_kinematics, joint_inverse_dynamics

FAST = Mark(15.0, of=("median",))
"""us, one tick of mathematics."""
AHEAD = Mark(15.0, at_most=False)
"""Times as fast as NumPy."""
TICKS = 2000
"""One period of the path at 1 kHz."""
_now = time.perf_counter_ns


def mathematics(benchmark: Benchmark) -> list[Figure]:
    """Follow one period of the path, tick by tick, with each of them."""
    benchmark.say("kernels and plain NumPy along one period of the path")
    c = benchmark.configuration
    parts = build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3).parts
    law = parts.law
    assert isinstance(law, JointInverseDynamics)
    path = along(parts, c.loop.rate_Hz)
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


def along(parts: Parts, rate_Hz: float) -> list[Record]:
    """Return the ticks of one period of the path: the reference, and the legs on it."""
    path = []
    for k in range(TICKS):
        tick = new_record()
        fill_reference(parts.platform, parts.trajectory.sample(k / rate_Hz), tick)
        tick["tick"], tick["t_d"] = k, k / rate_Hz
        tick["q"], tick["dq"] = tick["q_d"], tick["dq_d"]
        path.append(tick)
    return path


def _kernels(law: JointInverseDynamics, path: list[Record]) -> tuple[Array, Array]:
    """Return times (n, 3) ns and tau (n, 6) of what the loop calls."""
    estimator = Estimator(law.model.platform, path[0]["p_d"], path[0]["R_d"])
    times = np.zeros((len(path), 3))
    tau = np.zeros((len(path), 6))
    for k, each in enumerate(path):
        tick = copy_of(each)
        begun = _now()
        estimator.update(tick)
        located = _now()
        law.effort(tick)
        done = _now()
        tau[k] = tick["tau_law"]
        times[k] = located - begun, done - located, done - begun
    return times, tau


def _plain(law: JointInverseDynamics, path: list[Record]) -> tuple[Array, Array]:
    """Return the same of the NumPy version."""
    robot = PlainRobot.of(law.model.platform)
    pose = PlainPose(path[0]["p_d"], path[0]["R_d"], path[0]["twist_d"], np.zeros((6, 6)))
    K_P, K_D = law.gains["K_P"], law.gains["K_D"]
    times = np.zeros((len(path), 3))
    tau = np.zeros((len(path), 6))
    for k, tick in enumerate(path):
        q, dq, q_d, dq_d, ddq_d = (tick[name] for name in ("q", "dq", "q_d", "dq_d", "ddq_d"))
        begun = _now()
        pose = forward_kinematics(robot, q, dq, pose.p, pose.R)
        located = _now()
        ddq = ddq_d + K_D * (dq_d - dq) + K_P * (q_d - q)
        tau[k] = joint_inverse_dynamics(robot, pose, ddq)
        done = _now()
        times[k] = located - begun, done - located, done - begun
    return times, tau


def _mujoco(model: Model, path: list[Record]) -> list[Figure]:
    """Compare with MuJoCo's inverse dynamics: pose, twist and acceleration given, no forward kinematics."""
    try:
        from tools.benchmarks.mujoco_model import MujocoRobot  # noqa: PLC0415 - needs the extra
    except ImportError as error:
        why = str(error).splitlines()[0] if find_spec("mujoco") else "not installed (extra `benchmark`)"
        return [Figure("MuJoCo's inverse dynamics", note=why)]

    robot = MujocoRobot(model.platform, path[0]["p_d"], path[0]["R_d"])
    times = np.zeros((len(path), 2))
    worst = peak = 0.0
    nothing = np.zeros(6)
    for k, tick in enumerate(path):
        motion = PoseSample(tick["p_d"], tick["R_d"], tick["twist_d"], tick["dtwist_d"])
        begun = _now()
        tau = inverse_dynamics_kernel(model.constants, model.code, *motion, nothing)
        times[k, 0] = _now() - begun
        robot.place(*motion)
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
