"""Checks the reference before motion: leg lengths, rates, forces and condition against the limits."""

from math import ceil, inf
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Ints
from drivers.compiled.compiler import INTEGER, MATRIX, OUT_MATRIX, REAL, VECTOR, kernel
from hil.config.limits import LimitSettings
from hil.config.platform import PlatformSettings
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import jacobian_rate_kernel, lengths_and_jacobian
from hil.safety.guard import WINDOW_S
from hil.trajectory.path import SAMPLE, Trajectory, samples
from hil.trajectory.piecewise import PiecewisePolynomial
from plant_fmu.config import BenchPlant, PlantSettings, StewartPlant

LENGTH, RATE, ACCELERATION, FORCE, CONDITION = 0, 6, 12, 18, 24
"""Offsets in a row of results: q, dq, ddq (6,) m, m/s, m/s^2, tau (6,) N, and the condition number of J."""
SAMPLES = 20_000
"""Most samples of a walk; a longer path is sampled in longer steps."""
FEWEST = 5
"""Fewest samples within WINDOW_S that resolve the change of forces."""
PAIRS = 5_000
"""Evenly spread ticks of a longer path at which the force step is checked, in addition to its knots."""
IN_MM = "positions far beyond the robot's size: in mm instead of m? Divide x_m, y_m and z_m by 1000"
OTHER_UNIT = 50.0
"""Ratio of leg length to the longest leg above which the path must be in another unit."""


class Walk(NamedTuple):
    """Leg motion and forces along the sampled reference; rows are instants."""

    t: Array
    """(n,) s, instants along the reference."""
    q: Array
    """(n, 6) m, leg lengths."""
    dq: Array
    """(n, 6) m/s, leg rates."""
    ddq: Array
    """(n, 6) m/s^2, leg accelerations."""
    tau: Array
    """(n, 6) N, forces of the drives."""
    rest: Array
    """(2, 6) N, forces that hold the first and the last pose."""
    condition: Array
    """(n,) condition number of J with rotations scaled to lengths; inf where singular."""
    sign: Array
    """(n,) sign of det J; a change means that the path has crossed a singularity."""
    every_tick: bool
    """True if the step is one period of the loop."""
    repeats: bool
    """True if the path starts again where the walk ends."""
    jumps: tuple[Array, Array] | None = None
    """Force steps where ticks are skipped: instants (m,) s, changes (m, 6) N until the next tick."""
    leaps: tuple[Array, Array] | None = None
    """Changes (m, 6) m of the lengths from instants (m,) s until the next tick. None: those of `q`."""

    def forces(self) -> tuple[Array, Array]:
        """Instants (n,) s and forces (n, 6) N from rest to rest; two passes of a path that repeats."""
        passes = 2 if self.repeats else 1
        t = np.concatenate([self.t + k * self.t[-1] for k in range(passes)])
        tau = np.vstack([self.rest[:1], *[self.tau] * passes, self.rest[1:]])
        return np.concatenate([t[:1], t, t[-1:]]), tau

    def steps(self) -> tuple[Array, Array]:
        """Instants (n,) s and force steps (n, 6) N, each the change from the tick before.

        A longer path is checked at its ends, at its knots, where accelerations may jump, and at `PAIRS`
        ticks.
        """
        t, forces = self.forces()
        changes = np.vstack([np.zeros((1, 6)), np.diff(forces, axis=0)])
        if self.jumps is None:
            return t, changes
        n = len(self.t)
        sudden = [1, n + 1, 2 * n + 1] if self.repeats else [1, n + 1]
        instants = np.concatenate([t[sudden], self.jumps[0]])
        order = np.argsort(instants, kind="stable")
        return instants[order], np.vstack([changes[sudden], self.jumps[1]])[order]

    def swings(self, period: float) -> Array | None:
        """Largest force changes (n, 6) N within WINDOW_S; None where samples are too far apart."""
        step = period if self.every_tick or len(self.t) < 2 else float(self.t[1] - self.t[0])
        ticks = max(1, round(WINDOW_S / step))
        return window_swing(self.forces()[1], ticks) if ticks >= FEWEST or self.every_tick else None


class Violation(NamedTuple):
    """First instant at which a limit is violated, in s, with a message."""

    t: float
    message: str
    limit: str
    """Text of the limit, without leg and value."""


@kernel(MATRIX, MATRIX, VECTOR, INTEGER, REAL, MATRIX, OUT_MATRIX, OUT_MATRIX)
def walk_kernel(
    a: Array, b: Array, c: Array, code: int, radius: float, samples: Array, found: Array, Js: Array
) -> None:
    """Compute the leg motion found (n, 25) and J (n, 36) at each of the path's samples (n, 24).

    a, b (6, 3) m: base and platform joints. c, code: constants and code of the model, see
    `hil.robot.dynamics`. radius: m, scales rotations to displacements. Forces: `inverse_dynamics_kernel`.
    """
    p, R, twist, dtwist = np.empty(3), np.empty((3, 3)), np.empty(6), np.empty(6)
    no_wrench, l, J = np.zeros(6), np.empty(6), np.empty((6, 6))
    for k in range(len(samples)):
        for i in range(3):
            p[i] = samples[k, i]
            for j in range(3):
                R[i, j] = samples[k, 3 + 3 * i + j]
        for i in range(6):
            twist[i], dtwist[i] = samples[k, 12 + i], samples[k, 18 + i]
        lengths_and_jacobian(a, b, p, R, l, J)
        J_dot = jacobian_rate_kernel(a, b, p, R, twist)
        tau = inverse_dynamics_kernel(c, code, p, R, twist, dtwist, no_wrench)
        for i in range(6):
            rate = acceleration = 0.0
            for j in range(6):
                Js[k, 6 * i + j] = J[i, j]
                rate += J[i, j] * twist[j]
                acceleration += J[i, j] * dtwist[j] + J_dot[i, j] * twist[j]
            found[k, LENGTH + i], found[k, RATE + i] = l[i], rate
            found[k, ACCELERATION + i], found[k, FORCE + i] = acceleration, tau[i]
        found[k, CONDITION] = condition_kernel(J, radius)


def span_s(trajectory: Trajectory) -> float:
    """Duration, s, of the part of a path that is checked: one period of a path that repeats."""
    if isinstance(trajectory, PiecewisePolynomial):
        return trajectory.period_s
    return trajectory.duration_s or 0.0


def walk(
    platform: Platform,
    model: Model,
    trajectory: Trajectory,
    span: float,
    period: float,
    plant: PlantSettings | None = None,
) -> Walk:
    """Leg motion and forces along the reference over `span` s: once per `period` s, at most SAMPLES samples.

    Leg forces: inverse dynamics of `model`, plus friction and reflected mass of our own plant. The bench
    plant has its own equation. Forces are nan where the path meets a singularity. Raises ModelError where it
    begins or ends in one.
    """
    steps = ceil(span / period * (1 - 1e-12))
    n = min(steps, SAMPLES) + 1
    t = np.linspace(0.0, steps * period, n) if steps else np.zeros(1)
    # Just inside the end, where the path still moves: outside it rests.
    inside = span * (1 - 1e-12)
    q, dq, ddq, tau, condition, Js = _sampled(platform, model, trajectory, np.minimum(t, inside))
    still = np.zeros(6)
    ends = (trajectory.sample(0.0), trajectory.sample(span))
    rest = np.array([model.inverse_dynamics(s.p, s.R, still, still) for s in ends])
    forces = drive_forces(plant, q, dq, ddq, tau, rest)
    repeats = steps > 0 and (trajectory.duration_s is None or trajectory.duration_s > 1.5 * span)
    jumps = leaps = None
    if steps > n - 1 or repeats:
        ticks, end = _checked_ticks(trajectory, period, steps), inside
        if repeats:  # ticks of later passes may lie between those of the first
            end = inf if trajectory.duration_s is None else trajectory.duration_s * (1 - 1e-12)
            ticks = np.union1d(ticks, np.arange(SAMPLES if end == inf else min(SAMPLES, end // period)))
        at = np.asarray(period * ticks, float)
        parts = [_sampled(platform, model, trajectory, np.minimum(each, end)) for each in (at, at + period)]
        leaps = at, parts[1][0] - parts[0][0]
        if steps > n - 1:
            before, after = (drive_forces(plant, *part[:4], rest)[0] for part in parts)
            jumps = at, after - before
    sign = np.linalg.slogdet(Js)[0]
    return Walk(t, q, dq, ddq, *forces, condition, sign, steps == n - 1, repeats, jumps, leaps)


def _sampled(
    platform: Platform, model: Model, trajectory: Trajectory, t: Array
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """q, dq, ddq, tau, each (n, 6), condition (n,) and J (n, 6, 6) at instants (n,) s."""
    n = len(t)
    found, Js = np.empty((n, CONDITION + 1)), np.empty((n, 36))
    rows = samples(trajectory, t).view(float).reshape(n, SAMPLE.itemsize // 8)
    joints = platform.base_joints, platform.platform_joints
    walk_kernel(*joints, model.constants, model.code, platform.radius, rows, found, Js)
    q, dq, ddq, tau = (found[:, at : at + 6] for at in (LENGTH, RATE, ACCELERATION, FORCE))
    return q, dq, ddq, tau, found[:, CONDITION], Js.reshape(n, 6, 6)


def _checked_ticks(trajectory: Trajectory, period: float, steps: int) -> Ints:
    """Ticks at which the force step to the next tick is checked: around knots, and evenly spread."""
    ticks = np.linspace(0, steps - 1, PAIRS).astype(np.int64)
    if isinstance(trajectory, PiecewisePolynomial):
        knots = np.floor(trajectory.knots / period * (1 + 1e-12)).astype(np.int64)
        ticks = np.concatenate([ticks, knots - 1, knots])
    return np.unique(np.clip(ticks, 0, steps - 1))


def drive_forces(
    plant: PlantSettings | None, q: Array, dq: Array, ddq: Array, tau: Array, rest: Array
) -> tuple[Array, Array]:
    """Forces tau and rest, each (n, 6) N, with the plant's own terms added to those of the rigid-body model.

    The plant of six springs has its own equation, which ignores the given tau.
    """
    if plant is not None and isinstance(plant.model, StewartPlant):
        m = plant.model
        friction = m.viscous_friction_N_s_m * dq + m.coulomb_friction_N * np.sign(dq)
        return tau + friction + m.reflected_mass_kg * ddq, rest
    if plant is not None and isinstance(plant.model, BenchPlant):
        b = plant.model

        def spring(length: Array) -> Array:
            x: Array = length - b.rest_length_m
            return b.stiffness_N_m * x + b.stiffness_N_m3 * x**3

        return b.mass_kg * ddq + b.damping_N_s2_m2 * dq * np.abs(dq) + spring(q), spring(q[[0, -1]])
    return tau, rest


def violations(w: Walk, platform: PlatformSettings, limits: LimitSettings, period: float) -> list[Violation]:
    """First violation of each limit on the sampled reference, in order of time; period: of the loop, s.

    A path in another unit yields only that violation: the other limits have no meaning then.
    """
    if float(w.q.max()) > OTHER_UNIT * platform.length_max_m:
        return [_other_unit(w, platform.length_max_m)]
    low = platform.length_min_m + limits.stroke_margin_m
    high = platform.length_max_m - limits.stroke_margin_m
    room = np.where(w.dq < 0, w.q - low, high - w.q)
    cap = np.sqrt(2 * limits.deceleration_m_s2 * np.maximum(room, 0.0))
    speed, brake, force = limits.speed_m_s, limits.deceleration_m_s2, limits.force_N
    too_fast = (np.abs(w.dq) > np.maximum(cap, 1e-3)) & (room > 0)
    ends = f"length outside the soft ends {low:g} to {high:g} m"
    stop = f"too fast to stop before a soft end with limits.deceleration_m_s2 {brake:g}"
    found = [
        _first(w, np.maximum(low - w.q, w.q - high) > 0, w.q, ends, "m"),
        _first(w, np.abs(w.dq) > speed, w.dq, f"rate above limits.speed_m_s {speed:g}", "m/s"),
        _first(w, too_fast, w.dq, stop, "m/s"),
        _first(w, np.abs(w.tau) > force, w.tau, f"force above limits.force_N {force:g}", "N"),
        _singularity(w, limits.condition),
    ]
    if limits.acceleration_m_s2 is not None:
        text = f"acceleration above limits.acceleration_m_s2 {limits.acceleration_m_s2:g}"
        found.append(_first(w, np.abs(w.ddq) > limits.acceleration_m_s2, w.ddq, text, "m/s^2"))
    t, leap = (w.t[:-1], np.diff(w.q, axis=0)) if w.leaps is None else w.leaps
    text = f"moves within one tick by more than limits.speed_m_s {speed:g} allows, {speed * period:.4g} m, by"
    found.append(_first(w._replace(t=t), np.abs(leap) > speed * period * (1 + 1e-9), leap, text, "m"))
    t, step = w.steps()
    text = f"force changes by more than limits.force_step_N {limits.force_step_N:g} in one tick, by"
    found.append(_first(w._replace(t=t), np.abs(step) > limits.force_step_N, step, text, "N"))
    swing = w.swings(period)
    if swing is not None:
        text = f"force changes by more than limits.force_window_N {limits.force_window_N:g} within 250 ms, by"
        found.append(_first(w._replace(t=w.forces()[0]), swing > limits.force_window_N, swing, text, "N"))
    return sorted(v for v in found if v is not None)


def _other_unit(w: Walk, length_max_m: float) -> Violation:
    """Violation of a path in another unit, e.g. mm, at the first leg that would be too long."""
    k, leg = map(int, np.argwhere(w.q > OTHER_UNIT * length_max_m)[0])
    long = f"leg {leg} would be {w.q[k, leg]:.4g} m long, allowed: platform.length_max_m {length_max_m:g}"
    return Violation(float(w.t[k]), f"{IN_MM}. {long}", IN_MM)


def _singularity(w: Walk, limit: float) -> Violation | None:
    """First point of the path that is too close to a singularity, or past one."""
    turned = np.concatenate([[False], np.diff(w.sign) != 0])
    far = (w.condition > limit) | turned
    if not far.any():
        return None
    k = int(np.argmax(far))
    t = float(w.t[k])
    if turned[k] or not np.isfinite(w.condition[k]):
        text = "the path goes through a singularity of J, where no leg forces can hold the platform"
        return Violation(t, text, text)
    text = f"condition of J above limits.condition {limit:g}"
    return Violation(t, f"{text}: {w.condition[k]:.1f}", text)


def window_swing(forces: Array, ticks: int) -> Array:
    """Largest change of each leg's force against any of the `ticks` rows before, (n, 6) N."""
    low, high, covered = forces.copy(), forces.copy(), 1  # number of rows covered, up to each
    while covered < ticks + 1:
        step = min(covered, ticks + 1 - covered)
        low[step:] = np.minimum(low[step:], low[:-step])
        high[step:] = np.maximum(high[step:], high[:-step])
        covered += step
    return np.maximum(forces - low, high - forces)


def _first(w: Walk, bad: Flags, value: Array, text: str, unit: str) -> Violation | None:
    rows = bad.any(axis=1)
    if not rows.any():
        return None
    k = int(np.argmax(rows))
    leg = int(np.argmax(bad[k]))
    return Violation(float(w.t[k]), f"leg {leg}: {text}: {value[k, leg]:.6g} {unit}", text)
