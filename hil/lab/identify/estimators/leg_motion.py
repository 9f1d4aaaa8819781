"""Motion of the platform from leg lengths alone, differentiated without phase lag; forces filtered alike.

A bell-shaped window of finite length is convolved with the lengths. Its derivatives replace those of the
signal (M. Shinbrot, Trans. ASME 79, 1957). Lengths, rates, accelerations and forces pass the same filter, so
none lags another (M. Gautier, Proc. IEEE ICRA 1997), and each value depends on a known range of ticks.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from drivers.arrays import Array, Flags
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import forward_kinematics_kernel

SMOOTHING_S = 0.015
"""Half length of the bell: long enough for the encoders' steps, short enough for a nearly constant pose. The
filtered force is compared with the force at the filtered pose.
"""
FEWEST_TICKS = 4
"""Least half length of the window, ticks; fewer would not suffice for its derivatives."""
TOLERANCE_m = 1e-11


class LegSignals(NamedTuple):
    """Signals of six legs from a log, one row per consecutive tick."""

    period_s: float
    length: Array
    """(n, 6) m."""
    reference: Array
    """(n, 6) m, reference lengths: the same motion without the encoders' errors."""
    force: Array
    """(n, 6) N at the instant of the length, > 0 extends."""
    p: Array
    """(n, 3) m, and R (n, 3, 3): start poses of the forward kinematics."""
    R: Array
    good: Flags
    """(n,) True with open brakes and fresh readings of all legs."""
    cells: Array | None = None
    """(n, 6) N of load cells between the drives and the rods, > 0 extends; None without."""


class PlatformMotion(NamedTuple):
    """Motion of platform and legs at the n ticks of a log; only ticks marked `good` count."""

    R: Array
    """(n, 3, 3), x_base = p + R x_platform."""
    p: Array
    """(n, 3) m."""
    J: Array
    """(n, 6, 6), dq = J twist."""
    twist: Array
    """(n, 6) m/s, rad/s, base frame."""
    dtwist: Array
    """(n, 6)."""
    q: Array
    """(n, 6) m."""
    dq: Array
    """(n, 6) m/s."""
    ddq: Array
    """(n, 6) m/s^2."""
    force: Array
    """(n, 6) N."""
    dforce: Array
    """(n, 6) N/s, rate of the force."""
    good: Flags
    """(n,) True if no tick under the window is missing."""


class Bell(NamedTuple):
    """Weights of a smooth filter of finite length, and of its first two derivatives."""

    half: int
    """Ticks to either side."""
    value: Array
    first: Array
    second: Array


def half_ticks(period_s: float, smoothing_s: float = SMOOTHING_S) -> int:
    """Half length, in ticks, of the window that smooths the leg lengths."""
    return max(FEWEST_TICKS, round(smoothing_s / period_s))


def bell(half: int, period_s: float) -> Bell:
    """Window that reaches `half` ticks to either side, with its first two derivatives.

    With u = 1 - x^2 it is u^4 (a + b x^2), its derivatives u^3 (a x + b x^3) and u^2 (a + b x^2 + c x^4). The
    free coefficients make each exact for sampled polynomials up to the third degree: a filter that keeps
    parabolas does not shift nonlinear functions of the lengths.
    """
    x = np.arange(-half, half + 1) / half
    u, t = 1.0 - x * x, half * period_s * x
    value = _with_moments([u**4, u**4 * x**2], t, {0: 1.0, 2: 0.0})
    first = _with_moments([u**3 * x, u**3 * x**3], t, {1: 1.0, 3: 0.0})
    second = _with_moments([u**2, u**2 * x**2, u**2 * x**4], t, {0: 0.0, 2: 2.0, 4: 0.0})
    return Bell(half, value, first, second)


def _with_moments(basis: list[Array], t: Array, moments: dict[int, float]) -> Array:
    """Sum of basis functions whose moments, sums over t^k, have the given values."""
    B = np.array(basis)
    scaled = t / t[-1]
    A = np.array([B @ scaled**k for k in moments])
    wanted = [value / t[-1] ** k for k, value in moments.items()]
    return np.asarray(np.linalg.solve(A, wanted) @ B, np.float64)


def smooth(weights: Array, x: Array) -> Array:
    """sum_k weights_k x_{n+k} for x (n, m); zero where the weights reach beyond the ends."""
    half = len(weights) // 2
    y = np.zeros_like(x)
    if len(x) >= len(weights):
        y[half : len(x) - half] = sliding_window_view(x, len(weights), axis=0) @ weights
    return y


def all_under(half: int, good: Flags) -> Flags:
    """True at ticks with only good ticks up to `half` on either side; x (n,) or (n, m)."""
    inside = np.zeros_like(good)
    if len(good) > 2 * half:
        windows = sliding_window_view(good, 2 * half + 1, axis=0)
        inside[half : len(good) - half] = windows.all(axis=-1)
    return inside


def platform_motion(
    platform: Platform, signals: LegSignals, smoothing_s: float = SMOOTHING_S
) -> PlatformMotion:
    """Pose, twist and acceleration of the platform at each tick from smoothed lengths; forces filtered alike.

    Forward kinematics starts at the logged poses; a tick at which it does not converge is not good.
    """
    b = bell(half_ticks(signals.period_s, smoothing_s), signals.period_s)
    good = all_under(b.half, signals.good)
    q, dq, ddq, force, dforce = _smoothed(signals, b)
    p, R = signals.p.copy(), signals.R.copy()
    for k in np.flatnonzero(good):
        p[k], R[k], _, _, residual, _ = forward_kinematics_kernel(
            platform.base_joints, platform.platform_joints, q[k], p[k], R[k], TOLERANCE_m, 20
        )
        good[k] = residual <= TOLERANCE_m
    p[~good], R[~good] = 0.0, np.eye(3)
    twist, dtwist, J = np.zeros_like(q), np.zeros_like(q), np.tile(np.eye(6), (len(q), 1, 1))
    if good.any():
        twist[good], dtwist[good], J[good] = leg_to_platform(platform, p[good], R[good], dq[good], ddq[good])
    return PlatformMotion(R, p, J, twist, dtwist, q, dq, ddq, force, dforce, good)


def legs_alone(motion: PlatformMotion, signals: LegSignals) -> PlatformMotion:
    """The motion with lengths, rates and forces of the legs by a window of SMOOTHING_S.

    The window attenuates a sine by about 6e-4 (w T)^4, at 1.1 Hz and 30 ms 1e-6 of it.
    """
    q, dq, ddq, force, dforce = _smoothed(signals, bell(half_ticks(signals.period_s), signals.period_s))
    return motion._replace(q=q, dq=dq, ddq=ddq, force=force, dforce=dforce)


def _smoothed(signals: LegSignals, b: Bell) -> tuple[Array, Array, Array, Array, Array]:
    """Smoothed lengths and forces (n, 6), and derivatives: q, dq, ddq, force, dforce."""
    length, tau = (np.where(signals.good[:, None], x, 0.0) for x in (signals.length, signals.force))
    q, dq, ddq = (smooth(w, length) for w in (b.value, b.first, b.second))
    return q, dq, ddq, smooth(b.value, tau), smooth(b.first, tau)


def leg_to_platform(
    platform: Platform, p: Array, R: Array, dq: Array, ddq: Array
) -> tuple[Array, Array, Array]:
    """Twist (n, 6), its rate (n, 6) and J (n, 6, 6) from leg rates and accelerations at n poses.

    J twist = dq and J dtwist = ddq - s.(w x (w x r)) - (|u|^2 - dq^2) / l: velocity u of the platform
    joint at r from the origin, l ds = u - dq s (J.-P. Merlet, Parallel Robots, 2nd ed., 2006, ch. 5).
    """
    r = np.einsum("nij,kj->nki", R, platform.platform_joints)
    leg = p[:, None] + r - platform.base_joints
    l = np.linalg.norm(leg, axis=2, keepdims=True)
    s = leg / l
    J = np.concatenate([s, np.cross(r, s)], axis=2)
    twist = np.linalg.solve(J, dq[:, :, None])[:, :, 0]
    w = np.broadcast_to(twist[:, None, 3:], r.shape)
    u = twist[:, None, :3] + np.cross(w, r)
    turning = (s * np.cross(w, np.cross(w, r))).sum(axis=2) + ((u * u).sum(axis=2) - dq**2) / l[:, :, 0]
    dtwist = np.linalg.solve(J, (ddq - turning)[:, :, None])[:, :, 0]
    return twist, dtwist, J
