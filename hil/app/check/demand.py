"""Demands on the legs by lost commands, speed changes, jogs, probe pushes and a learned feed-forward."""

from itertools import product
from math import ceil, radians, sqrt
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.files import read_regular
from hil.app.compose import build_admission
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.feedforward_file import MOST_BYTES, feedforward_path, read_feedforward
from hil.app.derive_encoder_limits import believed_mass_kg, efficiencies, friction_N, stated_friction_N
from hil.app.reachability import Walk, drive_forces, window_swing
from hil.app.unknown_payload import unknown_payload
from hil.config.feedforward import FeedforwardHead
from hil.loop.jogging import jog_path, setup_share
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel, mass_matrix_kernel
from hil.robot.kinematics_kernels import jacobian_kernel
from hil.safety.encoder_limits import EncoderLimits
from hil.safety.guard import WINDOW_S
from hil.safety.residuals import MOVED
from hil.signals import JOG_NAMES
from hil.trajectory.override import CURVATURE, PEAK
from hil.trajectory.path import PoseSample, Trajectory
from plant_fmu.config import StewartPlant

MOST = 500
"""Most instants at which the forces of a speed change are computed."""
JOGS = 25
"""Number of instants of the reference from which jogs are tried."""
CREEPING = 1e-9
"""Share of the speed at which dry friction acts fully and every other effect of motion is negligible."""
STEEPEST = 1.875
"""Largest slope of the smooth step that fades a feed-forward, for unit height and length."""


class Silence(NamedTuple):
    """Travel of a leg with speed v after its drive receives no more commands: v T + a T^2 / 2."""

    T: float
    """drives.watchdog_ms and engage.brake_close_s: time until the brakes hold the legs, s."""
    a: float
    """The larger of the acceleration on the path and the one without force, m/s^2."""

    def travel_m(self, w: Walk) -> float:
        """Longest travel of a leg after silence on the path, m: from the top speed."""
        return float(self._travel(np.abs(w.dq)).max())

    def beyond(self, w: Walk, length_min_m: float, length_max_m: float) -> dict[str, float] | None:
        """Largest overrun of a hard end after silence on the path; None if every leg stops before.

        Keys: instant t, s, leg, travel_m until its brake holds, and free_m before the end of the stroke.
        """
        travel = np.stack((self._travel(np.maximum(-w.dq, 0.0)), self._travel(np.maximum(w.dq, 0.0))))
        free = np.stack((w.q - length_min_m, length_max_m - w.q))
        at = np.unravel_index(int(np.argmax(travel - free)), free.shape)
        if travel[at] <= free[at]:
            return None
        found = {"travel_m": float(travel[at]), "free_m": float(free[at])}
        return found | {"t": float(w.t[at[1]]), "leg": int(at[2])}

    def _travel(self, speed: Array) -> Array:
        return speed * self.T + 0.5 * self.a * self.T**2


class SpeedChange(NamedTuple):
    """Largest demand of a speed change on a leg, anywhere on the reference.

    At the speed share sigma, ddq = sigma^2 ddq_d + (d sigma/dt) dq_d, with the rates of sigma at the bounds
    of `hil.trajectory.override`.
    """

    acceleration_m_s2: float
    added_m_s2: float
    """Part of the acceleration by (d sigma/dt) dq_d."""
    force_N: float
    step_N: float
    """Force change from tick to tick, N, in addition to that of the reference."""
    felt_m_s2: float
    """|J M^-1 J^T tau|: acceleration on which an error of the model's inertia and weight acts."""


def speed_change(c: Configuration, w: Walk, trajectory: Trajectory, model: Model, span: float) -> SpeedChange:
    """Largest demand of a speed change within engage.stop_s. span: duration of the reference, s."""
    T, period = c.engage.stop_s, 1.0 / c.loop.rate_Hz
    rate, curvature = PEAK / T, CURVATURE / T**2
    rows = np.unique(np.linspace(0, len(w.t) - 1, MOST).astype(np.int64))
    q, dq, moving = w.q[rows], w.dq[rows], w.tau[rows]
    platform, still = model.platform, np.zeros(6)
    held, slowing, mobility = np.empty_like(q), np.empty_like(q), np.empty((len(q), 6, 6))
    for k, t in enumerate(w.t[rows].tolist()):
        p, R, twist, dtwist = trajectory.sample(min(t, span * (1 - 1e-12)))
        robot = model.constants, model.code, p, R
        J = jacobian_kernel(platform.base_joints, platform.platform_joints, p, R)
        mobility[k] = J @ np.linalg.solve(mass_matrix_kernel(model.constants, p, R), J.T)
        held[k] = inverse_dynamics_kernel(*robot, still, still, still)
        faster = inverse_dynamics_kernel(*robot, twist, dtwist + twist, still)
        slowing[k] = faster - inverse_dynamics_kernel(*robot, twist, dtwist, still)
    none = np.zeros_like(q)
    at_rest = drive_forces(c.plant, q, none, none, none, none[:2])[0]
    slowing += drive_forces(c.plant, q, none, dq, none, none[:2])[0] - at_rest
    creeping = drive_forces(c.plant, q, CREEPING * dq, none, held, none[:2])[0]
    added, changed = rate * np.abs(w.dq), rate * slowing
    felt = [np.einsum("kij,kj->ki", mobility, moving + each) for each in (changed, -changed)]
    step = period * (curvature * np.abs(slowing) + 2.0 * rate * np.abs(moving - creeping))
    return SpeedChange(
        float((np.abs(w.ddq) + added).max()),
        float(added.max()),
        float((np.maximum(np.abs(moving), np.abs(creeping)) + np.abs(changed)).max()),
        float(step.max()),
        float(np.abs(felt).max()),
    )


class JogDemand(NamedTuple):
    """Largest demand of a jog on a leg, from anywhere on the reference, both ways along each axis."""

    change_N: float
    """Force change within 250 ms, as the controller judges it; our plant's dry friction reverses once."""
    rate_m_s: float
    """Rate of the leg's length at the start of the jog."""


def jog_demand(c: Configuration, trajectory: Trajectory, model: Model, span: float) -> JogDemand:
    """Largest demand of jogs from the reference. span: duration of the reference, s."""
    admission, still, platform = build_admission(c, model.platform), np.zeros(6), model.platform
    speeds = c.operator.setup_speed_m_s, radians(c.operator.setup_speed_deg_s)
    plant = None if c.plant is None else c.plant.model
    friction_N = plant.coulomb_friction_N if isinstance(plant, StewartPlant) else 0.0
    change_N = rate_m_s = 0.0
    for t in np.linspace(0.0, span * (1 - 1e-12), JOGS).tolist():
        p, R, *_ = trajectory.sample(t)
        here = PoseSample(p, R, still, still)
        J = jacobian_kernel(platform.base_joints, platform.platform_joints, p, R)
        for axis, way in product(range(len(JOG_NAMES)), (1.0, -1.0)):
            start = jog_path(platform, here, axis, speeds, way).sample(0.0)
            share = setup_share(start, speeds)
            change_N = max(change_N, admission.change_N(start, share))
            rate_m_s = max(rate_m_s, float(np.abs(J @ (share * start.twist)).max()))
    return JogDemand(change_N + 2.0 * friction_N, rate_m_s)


def clipped(c: Configuration, limits: EncoderLimits, w: Walk) -> str | None:
    """Message on a probe push that a limit clips, or that moves a free leg too far; None: no such push.

    A probe push is a short force that tests whether a resting encoder still works. It is added to the path's
    force: without friction in both directions, with friction at once. A free leg is pushed for a time t until
    its motion is seen, and the law takes as long to stop it. It moves by up to push A t^2.
    """
    if limits.watched_legs == 0:
        return None
    yields = unknown_payload(c, believed_mass_kg(c)).mobility.max(axis=0)  # rotors included, as in the push
    A, late_s = np.diag(yields), limits.acting_ticks * limits.period_s
    following_m = c.limits.following_error_m
    beside_m = max(sqrt(following_m) - sqrt(2.0 * MOVED * limits.length_noise_m), 0.0)
    ticks = ceil(WINDOW_S / (w.t[1] - w.t[0])) if len(w.t) > 1 else 1
    force, window = c.limits.force_N, c.limits.force_window_N
    swing = window_swing(w.tau, ticks).max(axis=0)
    room = {
        f"limits.force_N {force:g}": force - np.abs(w.tau).max(axis=0),
        f"limits.force_window_N {window:g}": (window - swing) / (1.0 if limits.sticks else 2.0),
    }
    if limits.sticks:
        room[f"limits.following_error_m {following_m:g}"] = (beside_m / late_s) ** 2 / A
    room = {what: most for what, most in room.items() if (most >= 0.0).all()}  # else the path violates it
    if all((most >= limits.push_N).all() for most in room.values()):
        return None
    what, least = min(room.items(), key=lambda each: float((each[1] - limits.push_N).min()))
    beyond = least - limits.push_N
    leg, friction = int(np.argmin(beyond)), friction_N(c)
    driving, back_driving = efficiencies(c)
    most = friction + float(beyond[leg] / (1.0 / driving[leg] + back_driving[leg]))
    allowed = f"at most {most:.1f} N" if most >= 0.0 else "no push of this size"
    assumed = " (assumed)" if friction > stated_friction_N(c) else ""
    return (
        f"the probe push on a leg at rest is {limits.push_N[leg]:.0f} N: twice the friction, losses, and "
        f"monitor.disturbance_m_s2. It is too large for {what}, allowed: {allowed}, given: {friction:g} N"
        f"{assumed}; state the friction as measured, or raise {what.split()[0]}"
    )


class Learned(NamedTuple):
    """Learned feed-forward forces: their source, and their largest effects if they are wrong."""

    head: FeedforwardHead
    start_s: float
    end_s: float
    peak_N: float
    pushed_m_s2: float
    """Largest acceleration of a leg by a wrong feed-forward, m/s^2."""
    along_N: float
    """Largest force change per tick along the reference, N."""
    fading_N: float
    """Largest force change per tick while the feed-forward fades, N."""


def learned(c: Configuration, mobility: Array) -> Learned | None:
    """Learned feed-forward of section `feedforward`; None without. mobility: (6, 6) 1/kg at home."""
    settings = c.feedforward
    if settings is None:
        return None
    path, period_s = feedforward_path(settings, c.folder), 1.0 / c.loop.rate_Hz
    head, tau, start_s, step_s = read_feedforward(read_regular(path, MOST_BYTES), str(path))
    peak_N = float(np.abs(tau).max())
    return Learned(
        head,
        start_s,
        start_s + step_s * (len(tau) - 1),
        peak_N,
        pushed_m_s2=float(np.abs(tau @ mobility.T).max()),
        along_N=float(np.abs(np.diff(tau, axis=0)).max()) * period_s / step_s,
        fading_N=peak_N * min(STEEPEST * period_s / settings.fade_s, 1.0),
    )
